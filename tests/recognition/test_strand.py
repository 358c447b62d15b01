"""Joining of strands by bridges (section III.E)."""

import numpy as np
import pytest

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.shirakawa.reconstruction import reconnect_close_ends
from recognition.strand import End, Strand, bridge_gap, join_strands, strand_ends

PARAMETERS = ChainParameters.for_radius(0.01)


def end(point: tuple[float, float, float], direction: tuple[float, float, float]) -> End:
    return End(0, False, np.array(point), np.array(direction) / np.linalg.norm(direction))


def piece(first: int, last: int) -> Strand:
    """Return measured points along x at every centimetre from `first` to `last`, in either direction."""
    points = np.linspace((first * 0.01, 0.0, 0.0), (last * 0.01, 0.0, 0.0), abs(last - first) + 1)
    return Strand(points, np.zeros(len(points), dtype=bool))


def test_a_bridge_between_facing_ends_is_straight_and_evenly_spaced() -> None:
    filled = bridge_gap(end((0, 0, 0), (1, 0, 0)), end((0.06, 0, 0), (-1, 0, 0)), 0.01)
    np.testing.assert_allclose(filled, [(0.01 * k, 0, 0) for k in range(1, 6)], rtol=0, atol=1e-15)


def test_a_bridge_leaves_and_arrives_in_the_directions_of_the_ends() -> None:
    a, b = end((0, 0, 0), (1, 0.3, 0)), end((0.05, 0, 0.01), (-1, 0.3, 0))
    filled = np.vstack([a.point, bridge_gap(a, b, 0.0005), b.point])
    steps = np.diff(filled, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    # Steps of 0.5 mm on a curve of some 50 mm radius turn by 0.01 rad each, the first by half of that or so.
    assert steps[0] @ a.direction > np.cos(0.02)
    assert steps[-1] @ -b.direction > np.cos(0.02)
    assert (steps[1:] * steps[:-1]).sum(axis=1).min() > np.cos(0.03)


@pytest.mark.parametrize("gap_mm", [11, 24, 37, 60, 70])
def test_the_points_of_a_bridge_are_about_the_spacing_apart(gap_mm: int) -> None:
    a, b = end((0, 0, 0), (1, 0.2, 0)), end((gap_mm / 1000, 0, 0), (-1, -0.2, 0))
    chain = np.vstack([a.point, bridge_gap(a, b, 0.01), b.point])
    spacing = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    # The number is rounded (15 mm is one step or two), and the parameter of the cubic is not exactly its arc length.
    assert spacing.min() > 0.0075
    assert spacing.max() < 0.0155


def test_ends_closer_than_the_spacing_need_no_points_between() -> None:
    assert bridge_gap(end((0, 0, 0), (1, 0, 0)), end((0.008, 0, 0), (-1, 0, 0)), 0.01).shape == (0, 3)


@pytest.mark.parametrize("pair", [(1, 3), (3, 1)])
def test_a_given_bridge_is_used_in_the_direction_of_the_string(pair: tuple[int, int]) -> None:
    strands = [piece(0, 4), piece(10, 6)]
    bridge = np.array([(0.045, 0.01, 0.0), (0.055, 0.02, 0.0)])[:: 1 if pair[0] == 1 else -1]
    (joined,) = join_strands(strands, strand_ends(strands, PARAMETERS), [pair], PARAMETERS, {pair: bridge})
    assert joined.points[joined.bridged, 1].tolist() == [0.01, 0.02]
    assert (np.diff(joined.points[:, 0]) > 0).all()


def test_joining_turns_reversed_segments_and_keeps_the_order() -> None:
    # The middle one runs against the others.
    strands = [piece(0, 4), piece(10, 6), piece(12, 16)]
    ends = strand_ends(strands, PARAMETERS)
    (joined,) = join_strands(strands, ends, [(1, 3), (2, 4)], PARAMETERS)
    x = joined.points[:, 0]
    # All measured points, 1 cm apart, and one bridged point in each gap of 2 cm, in order.
    assert (np.diff(x) > 0).all() or (np.diff(x) < 0).all()
    np.testing.assert_allclose(np.sort(x), np.arange(17) * 0.01, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.sort(x[joined.bridged]), (0.05, 0.11), rtol=0, atol=1e-15)
    assert not joined.closed


def test_joining_that_begins_with_the_middle_strand_passes_each_strand_once() -> None:
    strands = [piece(6, 10), piece(0, 4), piece(12, 16)]
    ends = strand_ends(strands, PARAMETERS)
    (joined,) = join_strands(strands, ends, [(0, 3), (1, 4)], PARAMETERS)
    np.testing.assert_allclose(np.sort(joined.points[:, 0]), np.arange(17) * 0.01, rtol=0, atol=1e-15)
    assert len(set(np.sign(np.diff(joined.points[:, 0])))) == 1


def test_strands_without_a_partner_stay_as_they_are() -> None:
    strands = [piece(0, 4), piece(10, 6)]
    joined = join_strands(strands, strand_ends(strands, PARAMETERS), [], PARAMETERS)
    assert [s is t for s, t in zip(joined, strands, strict=True)] == [True, True]


@pytest.mark.parametrize("turned", [False, True])
def test_points_bridged_before_stay_marked(turned: bool) -> None:
    second = Strand(piece(6, 10).points, np.array([False, True, False, False, False]))
    if turned:
        second = Strand(second.points[::-1], second.bridged[::-1])
    strands = [piece(0, 4), second]
    (joined,) = join_strands(strands, strand_ends(strands, PARAMETERS), [(1, 3 if turned else 2)], PARAMETERS)
    np.testing.assert_allclose(np.sort(joined.points[joined.bridged, 0]), (0.05, 0.07), rtol=0, atol=1e-15)


def circle(start_deg: float, stop_deg: float, radius_m: float = 0.06) -> Strand:
    length = radius_m * np.radians(stop_deg - start_deg)
    angle = np.radians(np.linspace(start_deg, stop_deg, round(length / 0.01) + 1))
    points = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.zeros_like(angle)])
    return Strand(points, np.zeros(len(points), dtype=bool))


def on_the_circle(strand: Strand) -> None:
    # Ends' directions are chords over r_f, 10 degrees off this circle's tangent: over a gap of 16 mm the bridge
    # bulges by about 16 / 4 * tan(10 to 15 degrees) = 1 mm.
    np.testing.assert_allclose(np.linalg.norm(strand.points, axis=1), 0.06, rtol=0, atol=0.0012)
    ring = np.vstack([strand.points, strand.points[:1]])
    assert np.linalg.norm(np.diff(ring, axis=0), axis=1).max() < 0.0155
    # The polyline goes around once: it is as long as the circle.
    assert arc_length(ring)[-1] == pytest.approx(2 * np.pi * 0.06, rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_a_loop_in_one_piece_closes_on_itself(turned: bool) -> None:
    loop = circle(0, 345)
    if turned:
        loop = Strand(loop.points[::-1], loop.bridged)
    (closed,) = reconnect_close_ends([loop], np.empty((0, 3)), PARAMETERS)
    assert closed.closed
    on_the_circle(closed)
    np.testing.assert_array_equal(np.sort(closed.points[~closed.bridged], axis=0), np.sort(loop.points, axis=0))


@pytest.mark.parametrize("turned", range(8))
def test_a_loop_of_three_pieces_closes_for_any_direction_of_the_pieces(turned: int) -> None:
    pieces = [circle(0, 105), circle(120, 225), circle(240, 345)]
    pieces = [Strand(s.points[::-1], s.bridged) if turned >> k & 1 else s for k, s in enumerate(pieces)]
    (closed,) = reconnect_close_ends(pieces, np.empty((0, 3)), PARAMETERS)
    assert closed.closed
    on_the_circle(closed)


def test_a_short_piece_does_not_close_on_itself() -> None:
    # A ring of 15 mm radius: its ends are close and opposite, but no string of 10 mm radius bends so tightly.
    ring = circle(0, 310, radius_m=0.015)
    (alone,) = reconnect_close_ends([ring], np.empty((0, 3)), PARAMETERS)
    assert not alone.closed
