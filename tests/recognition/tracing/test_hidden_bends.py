"""Bends of strings under other strings, on hand-made fragments over surfaces seen from above."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.tracing.end_pairing import Pairing, pair_ends
from recognition.tracing.fragments import Fragment
from recognition.tracing.occlusion_map import OcclusionMap

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


def fragment(points: np.ndarray) -> Fragment:
    """Return the line as nodes r apart."""
    s = arc_length(points)
    even = np.linspace(0.0, s[-1], round(s[-1] / R) + 1)
    nodes = np.column_stack([np.interp(even, s, points[:, k]) for k in range(3)])
    return Fragment(nodes, np.ones(len(nodes)))


def paired_fragments(pairing: Pairing) -> set[frozenset[int]]:
    """Return the fragments that each pair joins."""
    return {frozenset(int(pairing.ends.fragment[end]) for end in pair) for pair in pairing.pairs}


def turned(straight: Callable, degrees: float) -> list[np.ndarray]:
    """Return the visible parts of a strand that turns while it passes under a strand along x."""
    turn = np.radians(degrees)
    before = straight((0, -0.05, R), (0, -1.7 * R, R))
    start = np.array([4 * R * np.sin(turn / 2), -1.7 * R + 4 * R * np.cos(turn / 2), R])
    return [before, straight(start, start + 0.05 * np.array([np.sin(turn), np.cos(turn), 0]))]


@pytest.mark.parametrize("degrees", [60, 80, 100])
def test_a_strand_turns_under_the_strand_that_hides_it(straight: Callable, seen: Callable, degrees: float) -> None:
    # As in a tight knot: the direction changes where the strand is hidden, and the ends before and after are straight.
    over, parts = straight((-0.05, 0, 3 * R), (0.05, 0, 3 * R)), turned(straight, degrees)
    surface, _ = seen([over, *parts])
    found = pair_ends([*map(fragment, parts), fragment(over)], OcclusionMap(surface), PARAMETERS)
    assert paired_fragments(found) == {frozenset({0, 1})}
    assert found.ambiguous == []
    assert len(found.bridges) == 1
    assert len(found.bends) > 0
    lifted = [part + (0, 0, 0.1) for part in (*parts, over)]
    above = pair_ends([*map(fragment, lifted)], OcclusionMap(surface + (0, 0, 0.1)), PARAMETERS, table_z_m=0.1)
    assert above.pairs == found.pairs


def test_a_strand_does_not_turn_under_the_edge_of_an_object(straight: Callable, seen: Callable) -> None:
    # The edge continues as a flat surface on one side, so that it is no string.
    over, parts = straight((-0.05, 0, 3 * R), (0.05, 0, 3 * R)), turned(straight, 100)
    surface, _ = seen([over, *parts])
    x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.001), np.arange(0, 0.03, 0.001))
    top = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 4 * R)])
    found = pair_ends([*map(fragment, (*parts, over))], OcclusionMap(np.vstack([surface, top])), PARAMETERS)
    assert found.bridges == {}


def test_a_strand_does_not_turn_in_plain_sight(straight: Callable, seen: Callable) -> None:
    parts = turned(straight, 100)
    surface, _ = seen(parts)
    assert pair_ends([*map(fragment, parts)], OcclusionMap(surface), PARAMETERS).pairs == []


@pytest.mark.parametrize(("height", "crossed"), [(3, False), (5, True)])
def test_two_strands_cross_under_a_strand_only_if_there_is_room(
    straight: Callable, seen: Callable, height: float, crossed: bool
) -> None:
    # Two strands pass under a third one. Straight on, they would cross each other there; bent, they do not.
    over = straight((-0.06, 0, height * R), (0.06, 0, height * R))
    slope = np.array([0.5, 1, 0]) / np.linalg.norm([0.5, 1, 0])
    parts = []
    for x in (-1, 1):
        for y in (-1, 1):
            corner = np.array([x * 1.1 * R, y * 2.2 * R, R])
            parts.append(straight(corner + (x * slope[0] * 0.05, y * slope[1] * 0.05, 0), corner))
    surface, _ = seen([over, *parts])
    found = pair_ends([*map(fragment, (*parts, over))], OcclusionMap(surface), PARAMETERS)
    straight_on, bent = {frozenset({0, 3}), frozenset({1, 2})}, {frozenset({0, 1}), frozenset({2, 3})}
    assert paired_fragments(found) == (straight_on if crossed else bent)


@pytest.mark.parametrize("is_measured", [True, False])
def test_a_bight_lies_under_two_strands_if_its_middle_is_measured(
    straight: Callable, seen: Callable, is_measured: bool
) -> None:
    # As in a square knot: a half turn, 6 r wide, begins and ends under two strands. Only its middle is visible.
    legs = [straight((-0.05, y * R, R), (-1.5 * R, y * R, R)) for y in (3, -3)]
    over = [straight((0.3 * R, y * 1.8 * R, 3 * R), (0.3 * R, y * 0.05, 3 * R)) for y in (1, -1)]
    turn = np.radians(np.arange(60, -61, -5))
    middle = np.column_stack([3 * R * np.cos(turn), 3 * R * np.sin(turn), np.full(len(turn), R)])
    surface, _ = seen([*over, *legs, *([middle] if is_measured else [])])
    found = pair_ends([*map(fragment, (*legs, *over))], OcclusionMap(surface), PARAMETERS)
    assert (frozenset({0, 1}) in paired_fragments(found)) is is_measured


@pytest.mark.parametrize("is_touched", [True, False])
def test_a_fragment_that_breaks_in_a_visible_bend_goes_on_only_around_another_strand(
    straight: Callable, seen: Callable, is_touched: bool
) -> None:
    # A bend of 70 degrees with a radius of 1.5 r, too tight for links. A strand alone does not bend so sharply.
    turn = np.radians(np.arange(0, 71, 2))
    bend = 1.5 * R * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    bend = np.column_stack([bend, np.full(len(bend), R)])
    after = bend[-1] + np.linspace(0, 0.05, 100)[:, None] * (np.cos(turn[-1]), np.sin(turn[-1]), 0.0)
    before = straight((-0.05, 0, R), (0, 0, R))
    inside = straight((-R, 2 * R, R), (-R, 0.05, R))
    curves = [before, after, *([inside] if is_touched else [])]
    surface, _ = seen([before, bend, after, *curves[2:]])
    found = pair_ends([*map(fragment, curves)], OcclusionMap(surface), PARAMETERS)
    assert (frozenset({0, 1}) in paired_fragments(found)) is is_touched
