"""Gaps that the depth images show: lines of sight that pass the axis of a string and end behind it."""

from collections.abc import Sequence

import numpy as np
import pytest

from recognition.geometry.polyline import arc_length
from recognition.preprocessing.lines_of_sight import MIN_VIEWS, count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.visible_gaps import split_at_visible_gaps
from recognition.strand import Strand
from tests.recognition.captured_strings import R, along_x, captured

RADII = np.array([R])


def tube(curve: np.ndarray) -> np.ndarray:
    """Return surface points on the upper half of a string, about 1 mm apart."""
    turn = np.linspace(0, np.pi, 13)
    along = np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(curve))])
    up = np.array([0.0, 0.0, 1.0])
    around = np.cos(turn)[None, :, None] * left[:, None] + np.sin(turn)[None, :, None] * up
    return (curve[:, None] + R * around).reshape(-1, 3)


def split(of: Strand, views: Sequence[NormalCloud], *curves: np.ndarray) -> list[Strand] | None:
    """Return the parts of a strand whose surface is that of the strings `curves`."""
    return split_at_visible_gaps([of], RADII, np.vstack([tube(curve) for curve in curves]), views)


def strand(points: np.ndarray, closed: bool = False) -> Strand:
    return Strand(points, np.zeros(len(points), dtype=bool), closed)


def with_gap(gap_radii: float) -> tuple[np.ndarray, np.ndarray]:
    return along_x(-0.1, -gap_radii * R / 2), along_x(gap_radii * R / 2, 0.1)


@pytest.mark.parametrize("gap_radii", [1.0, 2.0, 4.0])
def test_a_strand_over_a_gap_is_split_there(gap_radii: float) -> None:
    parts = split(strand(along_x(-0.1, 0.1)), captured(*with_gap(gap_radii)), *with_gap(gap_radii))
    assert parts is not None
    left, right = parts
    # A part reaches into the gap by less than a radius, which the localisation of the ends removes.
    assert -gap_radii * R / 2 - 0.2 * R <= left.points[-1, 0] < 0
    assert 0 < right.points[0, 0] <= gap_radii * R / 2 + 0.2 * R


@pytest.mark.parametrize("gap_radii", [0.0, 0.2])
def test_a_strand_without_a_visible_gap_is_not_split(gap_radii: float) -> None:
    assert split(strand(along_x(-0.1, 0.1)), captured(*with_gap(gap_radii)), *with_gap(gap_radii)) is None


def test_two_views_are_not_enough() -> None:
    views = captured(*with_gap(4.0))
    through = [view for view in views if count_views(along_x(0, 0.0005), R, [view]).through.any()]
    assert len(through) >= MIN_VIEWS
    assert split(strand(along_x(-0.1, 0.1)), through[: MIN_VIEWS - 1], *with_gap(4.0)) is None
    assert split(strand(along_x(-0.1, 0.1)), through[:MIN_VIEWS], *with_gap(4.0)) is not None


def test_a_short_part_is_dropped_and_an_inaccurate_end_is_no_gap() -> None:
    # The string ends at x = 0.09. Two radii of the line lie beyond a gap.
    curves = along_x(-0.1, 0.09), along_x(0.09 + 3 * R, 0.15)
    views = captured(*curves)
    (part,) = split(strand(along_x(-0.1, 0.09 + 5 * R)), views, *curves) or []
    assert part.points[-1, 0] == pytest.approx(0.09, abs=R)
    assert split(strand(along_x(-0.1, 0.09 + 0.9 * R)), views, *curves) is None


def test_surface_on_the_tube_shows_that_the_axis_is_inaccurate_instead() -> None:
    # A string that has surface where views look past its line is there; its line is not quite where it is.
    line, views = along_x(-0.1, 0.1), captured(*with_gap(4.0))
    assert split(strand(line), views, *with_gap(4.0)) is not None
    assert split(strand(line), views, line) is None


@pytest.mark.parametrize("start_deg", [90, 300])
def test_a_ring_with_a_gap_becomes_an_open_strand(start_deg: float) -> None:
    def arc(first_deg: float, last_deg: float) -> np.ndarray:
        turn = np.radians(np.arange(first_deg, last_deg, 1))
        return np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full_like(turn, R)])

    ring = strand(arc(start_deg, start_deg + 360), closed=True)
    (part,) = split(ring, captured(arc(8, 352)), arc(8, 352)) or []
    assert not part.closed
    assert arc_length(part.points)[-1] == pytest.approx(0.05 * np.radians(344), abs=R)
    assert part.points[0, 1] > 0 > part.points[-1, 1]
    assert max(abs(part.points[0, 1]), abs(part.points[-1, 1])) < 0.01
