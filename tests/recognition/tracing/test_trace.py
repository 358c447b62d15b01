"""Tracing from centre points to strands, on strings seen from above."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import recognition.tracing.trace
from recognition.errors import TooCrowdedError
from recognition.parameters import ChainParameters
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.trace import TracedStrands, trace_strands

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
NOISE = 0.05 * R

Surface = tuple[np.ndarray, np.ndarray]


def trace(surface: Surface, parameters: ChainParameters = PARAMETERS) -> TracedStrands:
    points, normals = surface
    return trace_strands(points - parameters.r * normals, OcclusionMap(points), parameters)


def strings_of(graph: TracedStrands, curves: Sequence[np.ndarray], scale: float = 1.0) -> list[int]:
    """Return for each strand, in ascending order, the curve whose two ends it has, within 1.5 r; -1 for any other."""
    ends = np.array([curve[[0, -1]] for curve in curves])
    found = []
    for strand in graph.strands:
        own = strand.points[[0, -1]]
        off = np.array([np.linalg.norm(ends - turned, axis=2).max(axis=1) for turned in (own, own[::-1])]).min(axis=0)
        found.append(int(off.argmin()) if off.min() < 1.5 * R * scale else -1)
    return sorted(found)


def hairpin(straight: Callable, arc: Callable, radius: float) -> np.ndarray:
    there, back = straight((-0.08, -radius, R), (0, -radius, R)), straight((0, radius, R), (-0.08, radius, R))
    return np.vstack([there, arc(radius, -90, 90)[1:], back[1:]])


@pytest.mark.parametrize("gap", [1.2, 2.0])
@pytest.mark.parametrize(
    "degrees", [(0, 30), (0, 60), (0, 90), (0, 60, 120)], ids=["30", "60", "90", "three on one another"]
)
def test_strands_that_cross_are_separated(
    seen: Callable, heap: Callable, off_line: Callable, degrees: tuple[float, ...], gap: float
) -> None:
    strands = heap(degrees, gap * R)
    for noise, seed in ((0.05, 0), (0.1, 1), (0.1, 2)):
        graph = trace(seen(strands, noise=noise * R, seed=seed))
        assert strings_of(graph, strands) == list(range(len(degrees)))
        # On the lines all along: a bridge under two strands may be half a radius off before it is fitted.
        assert max(off_line(strand.points, strands).max() for strand in graph.strands) < 0.6 * R


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_strands_side_by_side_in_contact_are_two(seen: Callable, straight: Callable, noise: float) -> None:
    strands = [straight((0, 0, R), (0.12, 0, R)), straight((0.02, 2 * R, R), (0.14, 2 * R, R))]
    assert strings_of(trace(seen(strands, noise=noise * R)), strands) == [0, 1]


@pytest.mark.parametrize("radius", [0.0125, 0.02])
def test_a_hairpin_is_one_strand(seen: Callable, straight: Callable, arc: Callable, radius: float) -> None:
    # Bent with three and five times its own radius; tighter ones are a cable's end.
    curve = hairpin(straight, arc, radius)
    assert strings_of(trace(seen([curve], noise=NOISE)), [curve]) == [0]


@pytest.mark.parametrize("radius", [0.02, 0.04])
def test_a_ring_is_closed(seen: Callable, arc: Callable, radius: float) -> None:
    (strand,) = trace(seen([arc(radius, 0, 360)], noise=NOISE)).strands
    assert strand.closed
    perimeter = np.linalg.norm(strand.points - np.roll(strand.points, -1, axis=0), axis=1).sum()
    # Bends draw nodes inwards: 4 % of 20 mm, 1 % of 40 mm.
    assert perimeter == pytest.approx(2 * np.pi * radius, rel=0.05)


def test_an_end_on_top_of_a_strand_and_one_that_butts_against_a_side(seen: Callable, straight: Callable) -> None:
    passing = straight((0, -0.06, R), (0, 0.06, R))
    on_top = straight((-0.08, 0, R), (0.003, 0, R))
    on_top[:, 2] += 2 * R * np.interp(on_top[:, 0], (-0.04, -0.005), (0, 1))
    assert strings_of(trace(seen([passing, on_top], noise=NOISE)), [passing, on_top]) == [0, 1]
    butting = straight((-0.08, 0, R), (-1.1 * R, 0, R))
    assert strings_of(trace(seen([passing, butting], noise=NOISE)), [passing, butting]) == [0, 1]


@pytest.mark.parametrize("gap", [0.0125, 0.015, 0.02, 0.05])
def test_ends_in_line_with_bare_table_between_are_not_joined(seen: Callable, straight: Callable, gap: float) -> None:
    strings = [straight((0, 0, R), (0.06, 0, R)), straight((0.06 + gap, 0, R), (0.14, 0, R))]
    assert strings_of(trace(seen(strings, noise=NOISE)), strings) == [0, 1]


def test_a_string_of_another_radius_is_followed_too(seen: Callable, straight: Callable) -> None:
    thick, thin = straight((0, 0.04, 1.5 * R), (0.1, 0.04, 1.5 * R)), straight((0, 0, 0.6 * R), (0.1, 0, 0.6 * R))
    graph = trace(seen([thick, thin], radii=[1.5 * R, 0.6 * R], noise=NOISE))
    assert len(graph.strands) == 2
    assert {round(float(strand.points[:, 1].mean()), 3) for strand in graph.strands} == {0.0, 0.04}
    assert all(np.ptp(strand.points[:, 0]) > 0.095 for strand in graph.strands)


@settings(deadline=None, max_examples=12, derandomize=True)
@given(
    turn=st.floats(0, 2 * np.pi),
    shift=st.tuples(*[st.floats(-1, 1)] * 3),
    scale=st.floats(0.3, 3),
    angle=st.floats(30, 150),
    gap=st.floats(1.2, 2),
    seed=st.integers(0, 2**32 - 1),
)
def test_strands_are_the_same_wherever_the_strings_lie_at_any_scale_in_any_order(
    seen: Callable,
    heap: Callable,
    turn: float,
    shift: tuple[float, ...],
    scale: float,
    angle: float,
    gap: float,
    seed: int,
) -> None:
    strands = heap((0, angle), gap * R)
    points, normals = seen(strands, noise=NOISE, seed=seed)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])
    order = np.random.default_rng(seed).permutation(len(points))
    moved = (scale * (points @ rotation.T + np.array(shift)))[order], (normals @ rotation.T)[order]
    graph = trace(moved, ChainParameters.for_radius(scale * R))
    back = [curve @ rotation.T + np.array(shift) for curve in strands]
    assert strings_of(graph, [scale * curve for curve in back], scale) == [0, 1]


def test_a_hole_of_a_radius_in_the_measurement_does_not_part_a_string(seen: Callable, straight: Callable) -> None:
    axis = straight((0, 0, R), (0.14, 0, R))
    points, normals = seen([axis], noise=NOISE)
    whole = np.abs(points[:, 0] - 0.06) > 0.5 * R
    assert strings_of(trace((points[whole], normals[whole])), [axis]) == [0]


def test_a_scene_with_too_many_fragments_is_rejected(
    seen: Callable, straight: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    strings = [straight((0, y, R), (0.04, y, R)) for y in (0, 0.03, 0.06)]
    surface = seen(strings, noise=NOISE)
    monkeypatch.setattr(recognition.tracing.trace, "MAX_FRAGMENTS", 3)
    assert len(trace(surface).strands) == 3
    monkeypatch.setattr(recognition.tracing.trace, "MAX_FRAGMENTS", 2)
    with pytest.raises(
        TooCrowdedError, match="form 3 fragments, too many for strings: check the string's radius and the workspace"
    ):
        trace(surface)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.6, 0.8)])
def test_points_on_one_line_are_finite(straight: Callable, up: tuple[float, float, float]) -> None:
    line = straight((0, 0, R), (0.1, 0, R))
    graph = trace((line, np.tile(up, (len(line), 1))))
    assert graph.strands
    assert all(np.isfinite(strand.points).all() for strand in graph.strands)


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), np.array([(0.1, 0.2, 0.008)]), np.tile((0.1, 0.2, 0.008), (500, 1)), np.zeros((40, 3))],
    ids=["none", "one", "all at one point", "all at the origin"],
)
def test_what_is_no_line_gives_no_strands(points: np.ndarray) -> None:
    graph = trace((points, np.tile((0.0, 0.0, 1.0), (len(points), 1))))
    assert (graph.strands, graph.fragments, graph.pairing.pairs) == ([], [], [])
    assert len(graph.nodes.points) == 0
