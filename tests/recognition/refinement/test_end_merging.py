"""Merging of two lines over one piece of string; strings that only come near each other stay two."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.refinement.end_merging import merge_overlapping_ends
from recognition.refinement.refinement import refine
from recognition.strand import Strand

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


def strand(points: np.ndarray) -> Strand:
    return Strand(points, np.zeros(len(points), dtype=bool))


def gapped(curve: np.ndarray, start: int, end: int) -> list[Strand]:
    return [strand(curve[:start]), strand(curve[end:])]


@pytest.mark.parametrize("turn", [0, 25])
@pytest.mark.parametrize("reverse", [0, 1, 2, 3])
def test_parts_of_a_string_with_a_hole_in_its_nodes_become_one(
    seen: Callable, arc: Callable, off_line: Callable, turn: int, reverse: int
) -> None:
    curve = arc(0.1, 0, 100)
    parts = gapped(curve, 80, 92)
    # Near the hole the first part's nodes are drawn aside, as next to a crossing.
    bent = parts[0].points.copy()
    bent[-8:, :2] += np.linspace(0, 8 * 0.001 * np.tan(np.radians(turn)), 8)[:, None] * (1, 0)
    parts[0] = strand(bent)
    parts = [strand(part.points[::-1]) if reverse >> k & 1 else part for k, part in enumerate(parts)]
    points, normals = seen([curve], R, noise=0.05 * R)
    (fitted,) = refine(parts, points, normals, PARAMETERS).strands
    assert not fitted.closed
    assert off_line(fitted.points, [curve]).max() < 0.1 * R
    ends = fitted.points[[0, -1]]
    off = min(np.linalg.norm(ends[::order] - curve[[0, -1]], axis=1).max() for order in (1, -1))
    # True ends are found within a tenth of a radius and the noise.
    assert off < 0.2 * R


def test_a_ring_with_a_hole_in_its_nodes_is_closed(seen: Callable, arc: Callable, off_line: Callable) -> None:
    ring = arc(0.04, 0, 360)
    points, normals = seen([ring], R, noise=0.05 * R)
    (fitted,) = refine([strand(ring[6:-6])], points, normals, PARAMETERS).strands
    assert fitted.closed
    assert off_line(fitted.points, [ring]).max() < 0.1 * R


def test_strings_that_end_near_one_another_stay_two(straight: Callable) -> None:
    line = straight((0, 0, R), (0.08, 0, R))
    for other in (
        # In line, with 2 mm of table between their ends, and touching; side by side, overlapping, to either side.
        straight((0.082, 0, R), (0.16, 0, R)),
        straight((0.0801, 0, R), (0.16, 0, R)),
        straight((0.06, 2 * R, R), (0.16, 2 * R, R)),
        straight((0.06, -2 * R, R), (-0.02, -2 * R, R)),
        # Against its side; over its end.
        straight((0.08, 0, R), (0.08, 0.08, R)),
        straight((0.07, -0.05, 3 * R), (0.07, 0.05, 3 * R)),
    ):
        for one in (line, line[::-1]):
            assert merge_overlapping_ends([strand(one), strand(other)], PARAMETERS) is None


def test_short_pieces_and_empty_scenes_are_not_merged(straight: Callable) -> None:
    assert merge_overlapping_ends([], PARAMETERS) is None
    piece = strand(straight((0, 0, R), (0.004, 0, R)))
    assert merge_overlapping_ends([piece], PARAMETERS) is None
