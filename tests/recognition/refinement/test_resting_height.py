"""Resting strings are one radius above what they rest on."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.refinement.resting_height import (
    MAX_EXCESS_SCATTERS,
    MIN_RESTING_POINTS,
    RestingHeights,
    add_lost_height,
    find_resting_heights,
)

Points = NDArray[np.float64]

R = 0.0042
RIPPLE = 0.02
"""Standard deviation of measured heights, in radii."""


def line(height: float | Points, count: int = 100, seed: int = 0, length_m: float = 0.3) -> Points:
    """Return a line (N, 3) along x at a height in radii, a number or (N,), with a ripple."""
    z = R * (height + np.random.default_rng(seed).normal(0.0, RIPPLE, count))
    return np.column_stack([np.linspace(-length_m / 2, length_m / 2, count), np.zeros(count), z])


def found(*lines: Points, floor_m: float = 0.0) -> RestingHeights:
    """Return the resting heights of lines of radius r."""
    count = len(lines)
    return find_resting_heights(lines, np.full(count, R), np.full(count, floor_m), R)


def lifted(middle: float, rest: float) -> Points:
    """Return heights (100,) in radii of a line that lifts in its middle within 30 mm."""
    x = np.abs(np.linspace(-150, 150, 100))
    return rest + (middle - rest) * (0.5 + 0.5 * np.cos(np.pi * np.minimum(x / 30, 1)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("floor_m", [0.0, -0.2])
def test_a_low_line_loses_height_and_rests_everywhere(seed: int, floor_m: float) -> None:
    resting = found(line(0.9, seed=seed) + (0, 0, floor_m), floor_m=floor_m)
    # The median of 100 heights: 1.25 * 0.02 / 10 radii, four of that are 0.01 radii.
    assert resting.lost_m == pytest.approx(0.1 * R, abs=0.01 * R)
    np.testing.assert_allclose(resting.height_m, floor_m + R, rtol=0, atol=1e-15)
    # The limit of the stiffness is at least 0.1 radii from the level, five sigma of the ripple.
    assert (resting.stiffness > 0).all()


def test_a_line_has_no_stiffness_where_it_lifts_over_another() -> None:
    level = line(np.full(100, 0.9), seed=1)
    upper = line(lifted(3.0, 0.9))
    under = level[:, [1, 0, 2]]
    resting = found(upper, under)
    is_lifted = upper[:, 2] > 1.5 * R
    assert is_lifted.sum() > 10
    assert (resting.stiffness[:100][is_lifted] == 0).all()
    is_far = np.abs(upper[:, 0]) > 0.04
    assert (resting.stiffness[:100][is_far] > 0).all()
    # As for a line that rests everywhere.
    assert resting.lost_m == pytest.approx(0.1 * R, abs=0.01 * R)


def test_a_high_line_loses_nothing() -> None:
    # Windows lower strings, so this height is an error of the radius or the table.
    resting = found(line(1.3))
    assert resting.lost_m == 0
    assert (resting.stiffness > 0).all()


def test_few_points_have_no_stiffness() -> None:
    few = found(line(0.9, MIN_RESTING_POINTS - 1, length_m=0.02))
    assert not few.stiffness.any()
    assert few.lost_m == 0
    enough = found(line(0.9, MIN_RESTING_POINTS, length_m=0.02))
    assert enough.stiffness.any()


def test_a_small_share_of_resting_points_has_no_stiffness() -> None:
    # 11 of 100 points are more than the minimum number, but less than the minimum share.
    heights = np.full(100, 5.0)
    heights[:11] = 0.9
    assert not found(line(heights)).stiffness.any()


def test_a_line_that_hangs_has_no_stiffness() -> None:
    resting = found(line(5.0))
    assert not resting.stiffness.any()
    assert resting.lost_m == 0


def test_each_line_has_the_height_of_its_radius_and_floor() -> None:
    lines = [line(0.9, 40), line(0.9, 60, seed=1) + (0, 0.1, 0.01)]
    radii = np.array([R, 1.1 * R])
    resting = find_resting_heights(lines, radii, np.array([0.0, 0.01]), R)
    assert resting.height_m.shape == resting.stiffness.shape == (100,)
    np.testing.assert_allclose(resting.height_m[:40], R, rtol=0, atol=1e-15)
    np.testing.assert_allclose(resting.height_m[40:], 0.01 + 1.1 * R, rtol=0, atol=1e-15)


@pytest.mark.parametrize("floor_m", [0.0, 0.3])
def test_lost_height_is_added_in_proportion(floor_m: float) -> None:
    top_m = 2 * R
    lost_m = 0.3 * R
    measured_top_m = top_m - lost_m
    z_m = floor_m + np.array([0.0, 0.5 * measured_top_m, measured_top_m, 4 * R])
    result = add_lost_height(z_m, floor_m, top_m, lost_m)
    gained = (result - z_m) / lost_m
    # Roundings of heights below a metre are 1e-16 m, relative to 1 mm.
    np.testing.assert_allclose(gained, [0.0, 0.5, 1.0, 1.0], rtol=0, atol=1e-12)
    assert result.shape == (4,)


def test_no_lost_height_changes_nothing() -> None:
    z_m = np.linspace(-R, 3 * R, 20)
    np.testing.assert_array_equal(add_lost_height(z_m, 0.0, 2 * R, 0.0), z_m)


def test_points_below_the_table_stay() -> None:
    z_m = np.array([-0.002, -0.0001])
    np.testing.assert_array_equal(add_lost_height(z_m, 0.0, 2 * R, 0.3 * R), z_m)


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.1])
def test_a_high_line_is_lowered_as_far_as_the_scatter_of_the_table_explains(scatter: float) -> None:
    lines = [line(1.1)]
    resting = find_resting_heights(lines, np.array([R]), np.zeros(1), R, table_scatter_m=scatter * R)
    # The median of 100 heights is within 0.01 radii, as above.
    assert resting.lost_m == pytest.approx(-min(0.1, MAX_EXCESS_SCATTERS * scatter) * R, abs=0.01 * R)


def test_a_low_line_is_raised_whatever_the_scatter_of_the_table() -> None:
    resting = find_resting_heights([line(0.9)], np.array([R]), np.zeros(1), R, table_scatter_m=0.1 * R)
    assert resting.lost_m == pytest.approx(0.1 * R, abs=0.01 * R)
