"""Pairing of fragment ends, on hand-made fragments over surfaces seen from above."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.tracing.end_pairing import MIN_CERTAIN_MARGIN, Pairing, pair_ends
from recognition.tracing.fragments import Fragment
from recognition.tracing.occlusion_map import OcclusionMap

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
NOTHING_SEEN = np.empty((0, 3))


def fragment(points: np.ndarray, closed: bool = False) -> Fragment:
    """Return the line as nodes r apart."""
    s = arc_length(points)
    even = np.linspace(0.0, s[-1], round(s[-1] / R) + 1)
    nodes = np.column_stack([np.interp(even, s, points[:, k]) for k in range(3)])
    return Fragment(nodes, np.ones(len(nodes)), closed)


def opened(curve: np.ndarray, reach: float, at: tuple[float, float] = (0.0, 0.0)) -> list[Fragment]:
    """Return the parts of a curve outside the circle of radius `reach` about `at`."""
    clear = np.linalg.norm(curve[:, :2] - at, axis=1) > reach
    runs = np.split(np.arange(len(curve)), np.flatnonzero(np.diff(clear)) + 1)
    return [fragment(curve[run]) for run in runs if clear[run[0]]]


def paired_fragments(pairing: Pairing) -> set[frozenset[int]]:
    """Return the fragments that each pair joins."""
    return {frozenset(int(pairing.ends.fragment[end]) for end in pair) for pair in pairing.pairs}


def test_ends_have_positions_directions_and_curvatures(arc: Callable, straight: Callable) -> None:
    ends = pair_ends(
        [fragment(straight((0, 0, R), (0.06, 0, R))), fragment(arc(0.04, 0, 90))],
        OcclusionMap(NOTHING_SEEN),
        PARAMETERS,
    ).ends
    np.testing.assert_array_equal(ends.fragment, [0, 0, 1, 1])
    np.testing.assert_allclose(ends.points[:2], [(0, 0, R), (0.06, 0, R)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ends.directions[:2], [(-1, 0, 0), (1, 0, 0)], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ends.curvatures[:2], 0, rtol=0, atol=1e-6)
    # A parabola through 21 mm of a circle of 40 mm: its direction and curvature are right to some percent.
    np.testing.assert_allclose(ends.directions[2:], [(0, -1, 0), (-1, 0, 0)], rtol=0, atol=0.05)
    np.testing.assert_allclose(ends.curvatures[2:], [(-25, 0, 0), (0, -25, 0)], rtol=0, atol=2.5)
    # Continued by the curvature, it stays on the circle; straight on, it leaves it by (10 mm)^2 / 80 mm, 1.25 mm.
    on, direction = ends.extrapolate(np.array([2]), np.array([0.01]), 1.0)
    assert np.hypot(*on[0, :2]) == pytest.approx(0.04, abs=0.0005)
    np.testing.assert_allclose(direction[0, :2], (-np.sin(0.25), -np.cos(0.25)), rtol=0, atol=0.05)
    off, _ = ends.extrapolate(np.array([2]), np.array([0.01]), 0.0)
    assert np.hypot(*off[0, :2]) == pytest.approx(0.04 + 0.01**2 / 0.08, abs=0.0005)


@pytest.mark.parametrize("degrees", [30, 60, 90])
def test_a_strand_goes_on_under_another(heap: Callable, seen: Callable, degrees: float) -> None:
    under, over = heap((0, degrees), 2 * R)
    surface, _ = seen([under, over])
    hidden = 1.3 * R / np.sin(np.radians(degrees))
    found = pair_ends([*opened(under, hidden), fragment(over)], OcclusionMap(surface), PARAMETERS)
    assert paired_fragments(found) == {frozenset({0, 1})}
    assert found.ambiguous == []


@pytest.mark.parametrize("degrees", [(0, 30), (0, 60), (0, 90), (0, 60, 120)])
def test_ends_around_a_heap_are_paired_straight_on(heap: Callable, seen: Callable, degrees: tuple[float, ...]) -> None:
    # As where soft strands are merged: the occluded ones have no nodes within 3 r, the one on top none within 1.4 r.
    strands = heap(degrees, 1.2 * R)
    surface, _ = seen(strands)
    reaches = [3 * R] * (len(strands) - 1) + [1.4 * R]
    pieces = [piece for strand, reach in zip(strands, reaches, strict=True) for piece in opened(strand, reach)]
    found = pair_ends(pieces, OcclusionMap(surface), PARAMETERS)
    assert paired_fragments(found) == {frozenset({2 * k, 2 * k + 1}) for k in range(len(degrees))}


def test_a_bent_strand_is_followed_round_its_bend(arc: Callable, heap: Callable, seen: Callable) -> None:
    # An arc passes under two strands side by side at its top; straight on from either end lies beside the other.
    bent = arc(0.04, 20, 160, centre=(0.0, -0.04))
    (over,) = heap((90,), 0)
    doubled = [over + (-R, 0, 2 * R), over + (R, 0, 2 * R)]
    surface, _ = seen([bent, *doubled])
    found = pair_ends([*opened(bent, 2.5 * R), *map(fragment, doubled)], OcclusionMap(surface), PARAMETERS)
    assert paired_fragments(found) == {frozenset({0, 1})}


def test_a_hole_in_a_tight_bend_is_bridged_along_the_bend(arc: Callable, seen: Callable) -> None:
    # 34 degrees of a bend of four radii are missing: straight on from both sides, the ends are as much apart.
    bent = arc(4 * R, -150, 150)
    angle = np.degrees(np.arctan2(bent[:, 1], bent[:, 0]))
    pieces = [bent[angle < -17], bent[angle > 17]]
    found = pair_ends([fragment(piece) for piece in pieces], OcclusionMap(seen(pieces)[0]), PARAMETERS)
    assert paired_fragments(found) == {frozenset({0, 1})}


def test_two_ends_with_bare_table_between_are_two_ends(straight: Callable, seen: Callable) -> None:
    strings = [straight((0, 0, R), (0.06, 0, R)), straight((0.078, 0, R), (0.14, 0, R))]
    found = pair_ends([fragment(string) for string in strings], OcclusionMap(seen(strings)[0]), PARAMETERS)
    assert found.pairs == []


def test_ends_far_apart_or_back_to_back_are_not_paired(straight: Callable, seen: Callable) -> None:
    strings = [straight((0, 0, R), (0.06, 0, R)), straight((0.125, 0, R), (0.18, 0, R))]
    # A long gap of 15.5 r, all of it under something.
    roof = [straight((0.055, y, 4 * R), (0.13, y, 4 * R)) for y in (-R, 0.0, R)]
    surface, _ = seen([*strings, *roof])
    assert pair_ends([fragment(string) for string in strings], OcclusionMap(surface), PARAMETERS).pairs == []
    # Two strands that lie side by side end at the same position.
    beside = [straight((0, y, R), (0.06, y, R)) for y in (0, 2 * R)]
    assert pair_ends([fragment(string) for string in beside], OcclusionMap(seen(beside)[0]), PARAMETERS).pairs == []


def test_a_lone_end_under_a_strand_stays_alone(heap: Callable, seen: Callable) -> None:
    under, over = heap((0, 90), 2 * R)
    under = under[under[:, 0] < 0]
    surface, _ = seen([under, over])
    found = pair_ends([fragment(under[under[:, 0] < -1.2 * R]), fragment(over)], OcclusionMap(surface), PARAMETERS)
    assert found.pairs == []


def test_a_ring_closes_under_the_strand_that_hides_it(arc: Callable, heap: Callable, seen: Callable) -> None:
    ring = arc(0.04, -170, 190)
    (over,) = heap((90,), 0)
    over = over + (-0.04, 0, 2 * R)
    surface, _ = seen([ring, over])
    clear = ring[np.abs(ring[:, 0] + 0.04) > 1.5 * R]
    clear = clear[(np.abs(clear[:, 1]) > 1.5 * R) | (clear[:, 0] > 0)]
    gap_first = np.roll(clear, -int(np.linalg.norm(np.diff(clear, axis=0), axis=1).argmax()) - 1, axis=0)
    found = pair_ends([fragment(gap_first), fragment(over)], OcclusionMap(surface), PARAMETERS)
    assert paired_fragments(found) == {frozenset({0})}


def test_ends_that_fit_either_of_two_are_ambiguous(straight: Callable, seen: Callable) -> None:
    # From under a wide object two strands come out, 8 degrees to either side of where one goes in.
    incoming = straight((-0.06, 0, R), (-0.015, 0, R))
    c, s = np.cos(np.radians(8)), np.sin(np.radians(8))
    out = [straight((0.015 * c, sign * 0.015 * s, R), (0.06 * c, sign * 0.06 * s, R)) for sign in (-1, 1)]
    roof = [straight((x, -0.03, 3 * R), (x, 0.03, 3 * R)) for x in (-0.008, 0.0, 0.008)]
    surface, _ = seen([incoming, *out, *roof])
    found = pair_ends([fragment(incoming), *map(fragment, out)], OcclusionMap(surface), PARAMETERS)
    assert len(found.pairs) == 1
    (pair,) = found.ambiguous
    assert np.linalg.norm(pair.points.mean(axis=0) - (0, 0, R)) < 2 * R
    # One of its ends is that of the strand that goes in; the other ends are 30 mm away.
    assert np.linalg.norm(pair.points - incoming[-1], axis=1).min() < 0.3 * R
    # Both strands fit equally well, so the margin is zero, except for roundings in sums of gains.
    assert -1e-9 < pair.margin < MIN_CERTAIN_MARGIN


def test_closed_fragments_have_no_ends(arc: Callable) -> None:
    found = pair_ends([fragment(arc(0.04, 0, 355), closed=True)], OcclusionMap(NOTHING_SEEN), PARAMETERS)
    assert (len(found.ends.points), found.pairs, found.ambiguous) == (0, [], [])
    nothing = pair_ends([], OcclusionMap(NOTHING_SEEN), PARAMETERS)
    assert (nothing.ends.points.shape, nothing.pairs) == ((0, 3), [])


@settings(deadline=None, max_examples=10, derandomize=True)
@given(turn=st.floats(0, 2 * np.pi), shift=st.tuples(*[st.floats(-1, 1)] * 3), seed=st.integers(0, 2**32 - 1))
def test_pairs_do_not_depend_on_pose_order_or_direction(
    heap: Callable, seen: Callable, turn: float, shift: tuple[float, ...], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    strands = heap((0, 45, 100), 1.2 * R, half=0.04)
    surface, _ = seen(strands)
    reaches = (3 * R, 3 * R, 1.4 * R)
    pieces = [piece for strand, reach in zip(strands, reaches, strict=True) for piece in opened(strand, reach)]
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])
    order = rng.permutation(len(pieces))
    moved_pieces: Sequence[Fragment] = [
        Fragment((pieces[k].points @ rotation.T + np.array(shift))[:: rng.choice((-1, 1))], pieces[k].support)
        for k in order
    ]
    moved = surface[rng.permutation(len(surface))] @ rotation.T + np.array(shift)
    found = pair_ends(moved_pieces, OcclusionMap(moved), PARAMETERS)
    assert {frozenset(int(order[k]) for k in pair) for pair in paired_fragments(found)} == {
        frozenset({0, 1}),
        frozenset({2, 3}),
        frozenset({4, 5}),
    }


@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_a_string_is_not_hidden_along_another_string(straight: Callable, seen: Callable, degrees: float) -> None:
    # The gap of 12 r is hidden: under six strings side by side, or along one of them.
    parts = [straight((-0.08, 0, R), (-6 * R, 0, R)), straight((6 * R, 0, R), (0.08, 0, R))]
    turn = np.radians(degrees)
    x, y = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    reach, beside = (5.8 * R, (0,)) if degrees == 0.0 else (0.05, (-5, -3, -1, 1, 3, 5))
    over = [straight(k * R * y - reach * x + (0, 0, 3 * R), k * R * y + reach * x + (0, 0, 3 * R)) for k in beside]
    surface, _ = seen([*parts, *over])
    found = pair_ends([fragment(curve) for curve in (*parts, *over)], OcclusionMap(surface), PARAMETERS)
    assert (frozenset({0, 1}) in paired_fragments(found)) is (degrees == 90.0)
