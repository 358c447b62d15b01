"""A flat object beside the table has a peak of its own, uneven noise has none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.preprocessing.plane_fit import is_other_peak

SEEDS = range(4)
COUNT = 4000
"""Number of points, about as many as `table_alignment` uses."""


def noise(seed: int, sigma_m: float, count: int = COUNT) -> NDArray[np.float64]:
    """Return normal heights (N,) of a plane."""
    return np.random.default_rng(seed).normal(0.0, sigma_m, count)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("upper_share", [0.2, 0.5, 0.7])
def test_a_plane_two_millimetres_higher_has_a_peak(seed: int, upper_share: float) -> None:
    # The planes are five standard deviations apart: the valley has a small part of the density of the lower peak.
    heights = noise(seed, 0.0004)
    heights[: round(upper_share * COUNT)] += 0.002
    assert is_other_peak(heights)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sigma_m", [0.0004, 0.0015])
def test_one_plane_has_one_peak(seed: int, sigma_m: float) -> None:
    # 1.5 mm is more than the minimum height of a second peak.
    assert not is_other_peak(noise(seed, sigma_m))


@pytest.mark.parametrize("seed", SEEDS)
def test_skewed_noise_has_one_peak(seed: int) -> None:
    # A sixth of the points has a tail that reaches as high as flat objects, but decreases from the plane on.
    heights = noise(seed, 0.0004)
    tail = COUNT // 6
    heights[:tail] += np.random.default_rng([seed, 1]).exponential(0.0015, tail)
    assert not is_other_peak(heights)
