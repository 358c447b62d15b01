"""The direction, first point and order of chains depend on where the strings lie, and not on how they were found."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from recognition.model.canonical_order import ORDER_AXIS, SIDE_AXIS, canonical_line, order_key

Points = NDArray[np.float64]
SPACING_M = 0.0042
NOISE_M = 0.0001
"""Standard deviation of the noise of rings, per axis, metres."""
T = np.linspace(0.0, 1.0, 96)


def flat(x: NDArray[np.float64], y: NDArray[np.float64]) -> Points:
    return np.column_stack([x, y, np.full(len(x), 0.0042)])


def spiral() -> Points:
    """Return two turns from 20 mm to 60 mm, whose ends are 40 mm apart."""
    return flat((0.02 + 0.04 * T) * np.cos(4 * np.pi * T), (0.02 + 0.04 * T) * np.sin(4 * np.pi * T))


OPEN = {
    "along x": flat(0.3 * T, 0.05 + 0 * T),
    "along y": flat(0.05 + 0 * T, 0.3 * T),
    "against x": flat(0.2 - 0.3 * T, 0 * T),
    "wave": flat(0.3 * T, 0.03 * np.sin(12 * T)),
    "hook": flat(0.05 * np.cos(5 * T), 0.05 * np.sin(5 * T)),
    "loop": flat(0.3 * T + 0.05 * np.sin(9 * T), 0.1 - 0.08 * np.cos(9 * T)),
    "spiral": spiral(),
    "nearly a ring": flat(0.06 * np.cos(6.2 * T), 0.06 * np.sin(6.2 * T)),
    "upright": np.column_stack([0.1 + 0.02 * T, 0 * T, 0.1 * T]),
}
"""Typical open strings, not symmetrical about the middle along x + y / 2."""


def ring(x: Callable[..., NDArray[np.float64]], y: Callable[..., NDArray[np.float64]], count: int) -> Points:
    t = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return flat(x(t), y(t))


RINGS = {
    "circle": ring(lambda t: 0.1 + 0.04 * np.cos(t), lambda t: -0.3 + 0.04 * np.sin(t), 60),
    "ellipse": ring(lambda t: 0.08 * np.cos(t), lambda t: 0.03 * np.sin(t), 86),
    "three lobes": ring(
        lambda t: (0.05 + 0.02 * np.cos(3 * t)) * np.cos(t), lambda t: (0.05 + 0.02 * np.cos(3 * t)) * np.sin(t), 90
    ),
    "kidney": ring(
        lambda t: (0.05 - 0.03 * np.cos(t)) * np.cos(t), lambda t: (0.05 - 0.03 * np.cos(t)) * np.sin(t), 80
    ),
}
"""Rings without crossings, counter-clockwise, with points about 4 mm apart."""


@pytest.mark.parametrize("name", OPEN)
def test_an_open_chain_and_its_reverse_have_one_order(name: str) -> None:
    points = OPEN[name]
    there, back = canonical_line(points, closed=False), canonical_line(points[::-1], closed=False)
    np.testing.assert_array_equal(there.points, back.points)
    np.testing.assert_array_equal(points[there.source], there.points)
    np.testing.assert_array_equal(points[::-1][back.source], back.points)


@pytest.mark.parametrize("name", OPEN)
def test_the_second_half_of_an_open_chain_lies_farther_along_x_and_half_of_y(name: str) -> None:
    points = canonical_line(OPEN[name], closed=False).points
    along = points[:, 0] + points[:, 1] / 2
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    # The moment about the middle of the chain, with each point weighted by the length that belongs to it.
    assert np.trapezoid(along * (s - s[-1] / 2), s) > 0


def test_a_straight_string_runs_along_x_and_half_of_y() -> None:
    for end, is_forward in (((0.1, 0.0), True), ((-0.1, 0.1), False), ((-0.1, 0.3), True), ((0.01, -0.1), False)):
        points = flat(end[0] * T, end[1] * T)
        first = canonical_line(points, closed=False).points[0]
        np.testing.assert_array_equal(first, points[0 if is_forward else -1])


@pytest.mark.parametrize("name", OPEN)
def test_noise_does_not_change_the_direction_of_an_open_chain(name: str) -> None:
    points = OPEN[name]
    is_forward = canonical_line(points, closed=False).source[0] == 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        # The ends of a chain are found a few millimetres too early or too late.
        first, last = rng.integers(0, 2, 2)
        noisy = points[first : len(points) - last]
        noisy = noisy + rng.normal(0, 0.0003, noisy.shape)
        assert (canonical_line(noisy, closed=False).source[0] == 0) == is_forward


@given(st.integers(0, 95), st.booleans(), st.sampled_from(sorted(RINGS)))
def test_a_ring_has_one_order_for_any_first_point_and_direction(first: int, is_reversed: bool, name: str) -> None:
    points = RINGS[name]
    expected = canonical_line(points, closed=True).points
    given_points = np.roll(points[::-1] if is_reversed else points, first, axis=0)
    line = canonical_line(given_points, closed=True)
    np.testing.assert_allclose(line.points, expected, rtol=0, atol=1e-12)
    # All points but the first are given points.
    np.testing.assert_array_equal(line.points[1:], given_points[line.source][1:])
    assert sorted(line.source) == list(range(len(points)))
    assert np.linalg.norm(line.points[0] - given_points[line.source[0]]) <= SPACING_M / 2 * 1.5


@pytest.mark.parametrize("name", RINGS)
def test_a_ring_begins_at_one_place_under_noise(name: str) -> None:
    points = RINGS[name]
    start = canonical_line(points, closed=True).points[0]
    for seed in range(100):
        rng = np.random.default_rng(seed)
        turned = np.roll(points[:: rng.choice((-1, 1))], rng.integers(len(points)), axis=0)
        first = canonical_line(turned + rng.normal(0, NOISE_M, points.shape), closed=True).points[0]
        # The first point moves along the ray with the noise of the two points beside it: 5 sigma. Across the ray, it
        # has the error of the mean of all points, which is far below the spacing of 4.2 mm.
        assert np.linalg.norm(first - start) < 5 * NOISE_M
        assert abs((first - start) @ SIDE_AXIS) < NOISE_M


@pytest.mark.parametrize("name", RINGS)
def test_a_ring_runs_counter_clockwise_from_the_ray_against_the_axis(name: str) -> None:
    points = canonical_line(RINGS[name][::-1], closed=True).points
    following = np.roll(points, -1, axis=0)
    assert (points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]).sum() > 0, "its area is positive"
    # The centroid of the polygon's edge.
    length = np.linalg.norm(following - points, axis=1)
    centroid = length @ ((points + following) / 2) / length.sum()
    # Replacing a point moves the centroid by less than 0.05 mm.
    assert (points[0] - centroid) @ SIDE_AXIS == pytest.approx(0.0, abs=5e-5)
    assert (points[0] - centroid) @ ORDER_AXIS < 0


@pytest.mark.parametrize("name", RINGS)
def test_a_ring_keeps_the_number_of_its_points_and_its_shape(name: str) -> None:
    points = RINGS[name]
    line = canonical_line(points, closed=True).points
    assert line.shape == points.shape
    before, after = (np.linalg.norm(p - np.roll(p, -1, axis=0), axis=1) for p in (points, line))
    # One point moves by up to half a spacing, so that one link gets longer and one shorter.
    assert after.max() <= 1.51 * before.max()
    assert after.min() >= 0.45 * before.min()
    # A corner is cut by up to the sagitta of 1.5 spacings, at the smallest bend radius of 20 mm.
    assert after.sum() == pytest.approx(before.sum(), abs=0.0005)


def test_a_ring_whose_first_point_is_canonical_is_unchanged() -> None:
    once = canonical_line(RINGS["circle"], closed=True).points
    again = canonical_line(once, closed=True)
    # The replaced point moved the centroid a little, and with it the ray.
    np.testing.assert_allclose(again.points, once, rtol=0, atol=5e-5)
    assert again.source[0] == 0


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize(
    "points",
    [
        np.array([(0.1, 0.2, 0.0)]),
        np.zeros((2, 3)),
        np.tile((0.1, 0.2, 0.0), (5, 1)),
        np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 0.1)]),
        np.linspace((0, 0, 0), 0.1 * ORDER_AXIS, 5),
        np.linspace((0, 0, 0), 0.1 * SIDE_AXIS, 5),
    ],
    ids=["one point", "twice the origin", "one place", "upright", "on the ray", "across the ray"],
)
def test_degenerate_lines_keep_their_points(points: Points, closed: bool) -> None:
    line = canonical_line(points, closed)
    assert sorted(line.source) == list(range(len(points)))
    assert np.isfinite(line.points).all()
    # A line across the ray may lose half a spacing at its first point.
    np.testing.assert_allclose(line.points, points[line.source], rtol=0, atol=0.0126)
    assert np.isfinite(order_key(points, closed))


def test_chains_are_ordered_by_x_and_half_of_y_of_their_means() -> None:
    scale = np.hypot(1.0, 0.5)
    # The mean is over the length: the dense half of the points does not count more.
    uneven = flat(np.concatenate([np.linspace(0, 0.1, 100), [0.2]]), np.full(101, 0.04))
    assert order_key(uneven, closed=False) * scale == pytest.approx(0.1 + 0.02, abs=1e-12)
    square = np.array([(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0), (0, 0.1, 0)])
    assert order_key(square, closed=True) * scale == pytest.approx(0.075, abs=1e-12)
    # Without the fourth side.
    assert order_key(square, closed=False) * scale == pytest.approx((0.05 + 0.1 + 0.05) / 3 + 0.025, abs=1e-12)


@pytest.mark.parametrize("name", [*OPEN, *RINGS])
def test_the_order_of_chains_does_not_depend_on_their_direction(name: str) -> None:
    closed = name in RINGS
    points = RINGS[name] if closed else OPEN[name]
    assert order_key(points[::-1], closed) == pytest.approx(order_key(points, closed), abs=1e-12)
