"""A first idea of the radius, from half strings of a known one, with noise and with other things on the table."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.rough_radius import HIGHEST_M, RadiusUnknownError, estimate_rough_radius

TABLE_Z = 0.3
"""Not 0, so that heights above the table and heights are told apart."""
STEP_M = 0.0007
"""Distance of the points seen: two of them in a cell of 1 mm."""
LOWEST_M = 0.0018
"""Height above the table from which on points are looked at."""

Points = NDArray[np.float64]


def grid(length: float, width: float, step: float = STEP_M) -> tuple[Points, Points]:
    """x and y of even points on a rectangle about the origin."""
    x, y = np.meshgrid(np.arange(-length / 2, length / 2, step), np.arange(-width / 2 + step / 4, width / 2, step))
    return x.ravel(), y.ravel()


def placed(x: Points, y: Points, z: Points, degrees: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> Points:
    """(N, 3) points at heights z above the table, turned about the vertical and then moved."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([c * x - s * y + at[0], s * x + c * y + at[1], z + TABLE_Z])


def string(
    r: float, noise: float = 0.0, seed: int = 0, degrees: float = 0.0, z: float = 0.0, length: float = 0.2
) -> Points:
    """The upper half of a straight string whose lowest point is at z above the table; `noise` is one sigma."""
    x, y = grid(length, 2 * r)
    height = z + r + np.sqrt(r**2 - y**2)
    return placed(x, y, height + np.random.default_rng(seed).normal(0.0, noise, len(x)), degrees)


def table(noise: float) -> Points:
    """What of a table of 400 by 400 mm scatters so high that it is looked at."""
    x, y = grid(0.4, 0.4, 0.001)
    z = np.random.default_rng(1).normal(0.0, noise, len(x))
    high = z > LOWEST_M
    return placed(x[high], y[high], z[high])


def block(length: float, width: float, height: float, degrees: float = 0.0, noise: float = 0.0004) -> Points:
    """The top of a box, 90 mm beside the string."""
    x, y = grid(length, width)
    z = height + np.random.default_rng(2).normal(0.0, noise, len(x))
    return placed(x, y, z, degrees, at=(0.0, 0.09))


def off_the_middle(r: float) -> float:
    """How much too small the radius of a string is where its height is taken 1 mm, a cell, off its middle."""
    return (r - np.sqrt(r**2 - 0.001**2)) / 2


@pytest.mark.parametrize("degrees", [0, 37, 90])
@pytest.mark.parametrize("r", [0.002, 0.0042, 0.01, 0.019])
def test_half_the_height_of_a_string_is_its_radius(r: float, degrees: float) -> None:
    found = estimate_rough_radius([string(r, degrees=degrees)], TABLE_Z)
    # Never more than the highest there is, to rounding.
    assert r - off_the_middle(r) <= found <= r + 1e-12


@pytest.mark.parametrize("noise", [0.0003, 0.0006])
@pytest.mark.parametrize("r", [0.002, 0.0042, 0.01])
def test_noise_is_halved(r: float, noise: float) -> None:
    found = estimate_rough_radius([string(r, noise, seed) for seed in range(3)], TABLE_Z)
    # A cell's third highest of six points is off by less than a sigma, the radius by half of that.
    assert found == pytest.approx(r, abs=off_the_middle(r) + noise / 2)


def test_views_that_see_a_side_each_are_taken_together() -> None:
    whole = string(0.0042)
    left = whole[:, 1] > 0
    assert estimate_rough_radius([whole[left], whole[~left]], TABLE_Z) == estimate_rough_radius([whole], TABLE_Z)


@pytest.mark.parametrize("noise", [0.0007, 0.001, 0.0015])
def test_the_tables_noise_is_no_string(noise: float) -> None:
    r = 0.0042
    found = estimate_rough_radius([string(r, 0.0003), table(noise)], TABLE_Z)
    assert found == pytest.approx(r, abs=off_the_middle(r) + 0.0003)


@pytest.mark.parametrize("degrees", [0, 20, 45])
@pytest.mark.parametrize(
    ("length", "width", "height"), [(0.08, 0.08, 0.008), (0.2, 0.03, 0.06), (0.1, 0.1, 0.0042), (0.2, 0.1, 0.09)]
)
def test_a_thing_beside_changes_nothing(length: float, width: float, height: float, degrees: float) -> None:
    r = 0.0042
    found = estimate_rough_radius([string(r), block(length, width, height, degrees)], TABLE_Z)
    # Few places of a thing are as wide as they are high: the median moves among the string's own heights.
    assert r - off_the_middle(r) <= found <= r * 1.01


def test_a_crossing_does_not_double_it() -> None:
    r = 0.0042
    over = string(r, degrees=90, z=2 * r, length=0.06)
    found = estimate_rough_radius([string(r), over], TABLE_Z)
    assert r - off_the_middle(r) <= found <= r * 1.01


def refusal(*clouds: Points) -> str:
    with pytest.raises(RadiusUnknownError) as refused:
        estimate_rough_radius(clouds, TABLE_Z)
    assert "give the radius" in str(refused.value)
    return str(refused.value)


def test_where_nothing_is_in_view_the_radius_must_be_given() -> None:
    nothing = np.empty((0, 3))
    above = block(0.02, 0.02, HIGHEST_M + 0.01)
    for clouds in ((), (nothing,), (above,), (table(0.001),)):
        assert refusal(*clouds).startswith("no string in view")


def test_where_things_lie_too_far_apart_a_smaller_workspace_is_asked_for() -> None:
    # 40 m apart, one along x and one along y.
    told = refusal(string(0.0042), string(0.0042) + (40.0, 0.0, 0.0), string(0.0042) + (0.0, 40.0, 0.0))
    size = [int(word) for word in told.split() if word.isdigit()]
    # Two cells of margin on either side.
    np.testing.assert_allclose(size, (40200, 40008), rtol=0, atol=5)
    assert "a smaller workspace" in told


@pytest.mark.parametrize("degrees", [0, 20, 45])
def test_where_nothing_is_like_a_string_it_is_said(degrees: float) -> None:
    why = "nothing above the table is as high as it is wide"
    assert refusal(block(0.08, 0.08, 0.008, degrees)).startswith(why)
    # Too high for its width, too thick for any string, and many crumbs of a string.
    assert refusal(block(0.1, 0.005, 0.03, degrees)).startswith(why)
    assert refusal(string(0.025, degrees=degrees)).startswith(why)
    crumb = string(0.0042, degrees=degrees, length=0.012)
    assert refusal(*(crumb + (0.03 * k, 0.0, 0.0) for k in range(30))).startswith(why)
