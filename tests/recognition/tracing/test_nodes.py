"""Nodes of the centre line: near the true lines, also where strands cross, and along them."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.parameters import ChainParameters
from recognition.tracing.nodes import CentreLineNodes, extract_nodes

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


def nodes_of(surface: tuple[np.ndarray, np.ndarray], parameters: ChainParameters = PARAMETERS) -> CentreLineNodes:
    points, normals = surface
    return extract_nodes(points - parameters.r * normals, parameters)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
def test_a_straight_string_has_nodes_on_its_axis(
    seen: Callable, straight: Callable, off_line: Callable, noise: float
) -> None:
    axis = straight((0, 0, R), (0.15, 0, R))
    nodes = nodes_of(seen([axis], noise=noise * R))
    # A node is the mean of some 40 points: 0.1 r of noise comes to 0.016 r, and the edge of a voxel to as much.
    assert off_line(nodes.points, [axis]).max() < 0.05 * R
    # All along it, the ends not drawn inwards by more than a voxel's mean, and direction known.
    along = np.sort(nodes.points[:, 0])
    assert along[0] < 0.5 * R
    assert along[-1] > 0.15 - 0.5 * R
    assert np.diff(along).max() < R
    assert np.abs(nodes.directions[:, 0]).min() > np.cos(np.radians(5))
    np.testing.assert_allclose(np.linalg.norm(nodes.directions, axis=1), 1.0, rtol=0, atol=1e-12)
    assert nodes.rho.min() > 0.8


@pytest.mark.parametrize(
    ("degrees", "gap"), [((0, 30), 2.0), ((0, 60), 2.0), ((0, 90), 2.0), ((0, 60), 1.2), ((0, 90), 1.2)]
)
def test_strands_that_cross_are_each_drawn_to_their_own_line(
    seen: Callable, heap: Callable, off_line: Callable, degrees: tuple[float, float], gap: float
) -> None:
    strands = heap(degrees, gap * R)
    nodes = nodes_of(seen(strands, noise=0.05 * R))
    # Most of it is the bend of the strand on top (see below); the merged flanks must not add to it.
    assert off_line(nodes.points, strands).max() < 0.15 * R


def test_strands_side_by_side_keep_their_lines(seen: Callable, straight: Callable, off_line: Callable) -> None:
    # In contact all along, as two strands of a doubled string lie.
    strands = [straight((0, 0, R), (0.12, 0, R)), straight((0.02, 2 * R, R), (0.14, 2 * R, R))]
    nodes = nodes_of(seen(strands, noise=0.1 * R))
    assert off_line(nodes.points, strands).max() < 0.08 * R


@pytest.mark.parametrize("radius", [0.02, 0.04, 0.08])
def test_a_bend_draws_nodes_inwards_by_its_sagitta_only(seen: Callable, arc: Callable, radius: float) -> None:
    nodes = nodes_of(seen([arc(radius, 0, 360)]))
    inwards = radius - np.linalg.norm(nodes.points[:, :2], axis=1)
    # The mean over 1.6 r to either side, weighted 1 - u^2, lies a fifth of the sagitta inside: thrice, and to first
    # order in r / radius.
    expected = 3 * 0.2 * (1.6 * R) ** 2 / (2 * radius)
    assert inwards.max() < 1.2 * expected
    assert inwards.min() > 0


def test_single_specks_and_balls_give_no_nodes(seen: Callable, straight: Callable) -> None:
    points, normals = seen([straight((0, 0, R), (0.1, 0, R))])
    specks = np.array([(0.05, -0.05, R), (0.09, -0.05, R), (0.09, -0.05, R)])
    ball = np.random.default_rng(0).standard_normal((1500, 3))
    ball *= 0.9 * R / np.linalg.norm(ball, axis=1, keepdims=True)
    nodes = extract_nodes(np.vstack([points - R * normals, specks, ball + (0.05, 0.05, R)]), PARAMETERS)
    # A speck shows no line, and a ball's main axis has a third of it. The string's nodes stay.
    assert np.abs(nodes.points[:, 1]).max() < 0.05 * R
    assert len(nodes.points) > 0.1 / R


def test_nodes_scale_with_the_radius(seen: Callable, heap: Callable) -> None:
    points, normals = seen(heap((0, 70), 2 * R), noise=0.05 * R)
    small, large = ChainParameters.for_radius(0.004), ChainParameters.for_radius(0.016)
    a = extract_nodes(points - small.r * normals, small)
    b = extract_nodes(4 * (points - small.r * normals), large)
    # Fourfold is exact in doubles, so the same voxels and the same sums come out.
    np.testing.assert_allclose(b.points, 4 * a.points, rtol=1e-9, atol=0)
    np.testing.assert_allclose(np.abs((a.directions * b.directions).sum(axis=1)), 1.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(b.support, a.support, rtol=1e-9, atol=0)


@settings(deadline=None, max_examples=15, derandomize=True)
@given(turn=st.floats(0, 2 * np.pi), shift=st.tuples(*[st.floats(-1, 1)] * 3), seed=st.integers(0, 2**32 - 1))
def test_nodes_move_with_the_string_whatever_the_order_of_the_points(
    seen: Callable, heap: Callable, off_line: Callable, turn: float, shift: tuple, seed: int
) -> None:
    strands = heap((0, 60), 1.2 * R)
    points, normals = seen(strands, noise=0.05 * R)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])
    order = np.random.default_rng(seed).permutation(len(points))
    moved = nodes_of(((points @ rotation.T + np.array(shift))[order], (normals @ rotation.T)[order]))
    # Voxels fall differently, so other points of the same lines are nodes.
    assert off_line((moved.points - np.array(shift)) @ rotation, strands).max() < 0.2 * R


def test_chosen_nodes_keep_their_values() -> None:
    nodes = CentreLineNodes(
        np.arange(12.0).reshape(4, 3), np.tile((1.0, 0, 0), (4, 1)), np.arange(4.0), np.full(4, 0.9)
    )
    for chosen in (nodes[np.array([False, True, False, True])], nodes[np.array([1, 3])]):
        np.testing.assert_array_equal(chosen.points, [(3, 4, 5), (9, 10, 11)])
        np.testing.assert_array_equal(chosen.support, [1, 3])
