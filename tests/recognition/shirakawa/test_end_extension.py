"""Strands reach the ends of the string, and only observed ends are free."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.centre_line import CentreLine, estimate_centre_line
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.shirakawa.end_extension import classify_ends, extend_ends
from recognition.shirakawa.enhanced_matching import match_enhanced, thin
from recognition.shirakawa.reconstruction import reconstruct
from recognition.strand import Strand

HALF_M = 0.06


@pytest.fixture(scope="module")
def capped(table_1: ChainParameters, tube: Callable) -> CentreLine:
    """The centre line cloud of a string from x = -60 to 60 mm, its flat ends seen with their normals along x."""
    x = np.arange(-HALF_M, HALF_M + 1e-9, 0.001)
    axis = np.column_stack([x, np.zeros_like(x), np.full_like(x, table_1.r)])
    points, normals = tube(axis, table_1.r)
    # No two centres have the same position, as in no measurement.
    shift = np.random.default_rng(0).uniform(-0.0004, 0.0004, len(points))
    points = np.clip(points + np.outer(shift, (1, 0, 0)), (-HALF_M, -1, -1), (HALF_M, 1, 1))
    disc = np.array([(0.0, y, z) for y in (-2, 0, 2) for z in (-2, 0, 2)]) / 1000 + (0, 0, table_1.r)
    caps = np.vstack([disc - np.array([HALF_M, 0, 0]), disc + np.array([HALF_M, 0, 0])])
    outwards = np.repeat([(-1.0, 0, 0), (1.0, 0, 0)], 9, axis=0)
    return estimate_centre_line(np.vstack([points, caps]), np.vstack([normals, outwards]), table_1)


def straight(start_mm: float, end_mm: float, step_mm: float = 4.2) -> Strand:
    x = np.arange(start_mm, end_mm + 1e-9, step_mm) / 1000
    return Strand(np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.0042)]), np.zeros(len(x), dtype=bool))


def centres(start_mm: float, end_mm: float) -> np.ndarray:
    return straight(start_mm, end_mm, step_mm=0.1).points


def test_extension_reaches_the_true_ends_of_a_capped_cylinder(table_1: ChainParameters, capped: CentreLine) -> None:
    thinned = thin(capped.points, table_1)
    segments = [thinned[segment] for segment in match_enhanced(thinned, table_1).segments]
    strands = reconstruct(segments, np.empty((0, 3)), capped.unaveraged, table_1).connected
    (before,), (after,) = strands, extend_ends(strands, capped.unaveraged, table_1)
    assert np.abs(before.points[[0, -1], 0]).max() < HALF_M - table_1.r / 2
    # The 95th percentile of the centres ahead, over up to 3 r of string: 0.6 mm short at most, and never beyond.
    np.testing.assert_allclose(np.sort(after.points[[0, -1], 0]), (-HALF_M, HALF_M), rtol=0, atol=0.0007)
    assert np.abs(after.points[:, 0]).max() <= HALF_M + 1e-9
    np.testing.assert_allclose(
        after.points[:, 1:], np.broadcast_to((0, table_1.r), (len(after.points), 2)), atol=0.0002
    )


def test_added_points_are_in_order_and_about_r_n_apart(table_1: ChainParameters) -> None:
    strand = straight(-42, 42)
    (longer,) = extend_ends([strand], centres(-51, 52), table_1)
    x = longer.points[:, 0]
    assert (np.diff(x) > 0).all()
    # 9 and 10 mm of reach make two steps each.
    assert len(x) == len(strand.points) + 4
    assert 0.5 * table_1.r_n < np.diff(x).min() <= np.diff(x).max() < 1.5 * table_1.r_n
    # Measured, not bridged.
    assert not longer.bridged.any()
    # The measured points themselves stay.
    np.testing.assert_array_equal(longer.points[2:-2], strand.points)


def test_bridged_points_stay_bridged(table_1: ChainParameters) -> None:
    strand = straight(0, 42)
    bridged = np.arange(len(strand.points)) == 4
    (longer,) = extend_ends([Strand(strand.points, bridged)], centres(-8, 42), table_1)
    assert longer.bridged.sum() == 1
    np.testing.assert_array_equal(longer.points[longer.bridged], strand.points[[4]])


def test_nothing_ahead_nothing_added(table_1: ChainParameters) -> None:
    strand = straight(0, 42)
    # Beside the ray (more than r across), behind the end, and beyond the extent of an intersection.
    elsewhere = np.vstack([centres(42, 60) + np.array([0, 0.0045, 0]), centres(5, 41), centres(56, 90)])
    (same,) = extend_ends([strand], elsewhere, table_1)
    np.testing.assert_array_equal(same.points, strand.points)
    closed = Strand(strand.points, strand.bridged, closed=True)
    assert extend_ends([closed], centres(-10, 60), table_1) == [closed]


def test_both_ends_of_a_string_in_the_open_are_free(table_1: ChainParameters) -> None:
    scene = Scene(workspace_m=((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.1)))
    # Some centres still lie ahead, by noise, within r_n.
    assert classify_ends(straight(-42, 42), centres(-44, 44), scene, table_1) == ("free", "free")
    assert classify_ends(straight(-42, 42), centres(-44, 44), Scene(), table_1) == ("free", "free")


@pytest.mark.parametrize("reverse", [False, True])
def test_an_end_at_the_border_of_the_workspace_is_unobserved(table_1: ChainParameters, reverse: bool) -> None:
    # The last point at 42 mm is within r_f = 8.4 mm of the border, the first is not.
    scene = Scene(workspace_m=((-0.1, 0.05), (-0.1, 0.1), (0.0, 0.1)))
    strand = straight(-42, 42)
    expected = ("free", "unobserved")
    if reverse:
        strand, expected = Strand(strand.points[::-1], strand.bridged), ("unobserved", "free")
    assert classify_ends(strand, centres(-42, 42), scene, table_1) == expected
    # The same at the other pair of sides.
    turned = Strand(strand.points[:, [1, 0, 2]], strand.bridged)
    scene = Scene(workspace_m=((-0.1, 0.1), (-0.1, 0.05), (0.0, 0.1)))
    assert classify_ends(turned, centres(-42, 42)[:, [1, 0, 2]], scene, table_1) == expected


def test_an_end_beyond_which_the_string_continues_is_unobserved(table_1: ChainParameters) -> None:
    ahead = np.vstack([centres(-42, 42), centres(48, 70)])
    assert classify_ends(straight(-42, 42), ahead, Scene(), table_1) == ("free", "unobserved")
    # Farther than the extent of an intersection, or beside the ray: another string.
    far = np.vstack([centres(-42, 42), centres(56, 90), centres(43, 60) + np.array([0, 0.006, 0])])
    assert classify_ends(straight(-42, 42), far, Scene(), table_1) == ("free", "free")


def test_a_closed_strand_has_no_unobserved_end(table_1: ChainParameters) -> None:
    strand = straight(-42, 42)
    closed = Strand(strand.points, strand.bridged, closed=True)
    assert classify_ends(closed, centres(-80, 80), Scene(), table_1) == ("free", "free")
