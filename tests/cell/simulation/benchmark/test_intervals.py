"""Confidence intervals of shares against SciPy, and against clusters whose interval is known."""

import numpy as np
import pytest
from scipy.stats import binomtest

from cell.simulation.benchmark.intervals import clustered_interval, wilson_interval


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (40, 40), (37, 40), (3, 6), (0, 12), (979, 1000)])
def test_it_is_the_wilson_interval_of_scipy(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes / trials, trials) == pytest.approx((expected.low, expected.high), abs=6e-5)


def test_without_a_trial_there_is_no_interval() -> None:
    assert wilson_interval(0.0, 0) is None
    assert clustered_interval([], []) is None
    assert clustered_interval([0, 0], [0, 0]) is None


def test_independent_points_have_the_interval_of_their_number() -> None:
    rng = np.random.default_rng(1)
    successes = rng.binomial(100, 0.9, size=400)
    found = clustered_interval(successes.tolist(), [100] * 400)
    expected = wilson_interval(successes.sum() / 40_000, 40_000)
    assert found is not None
    assert expected is not None
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=0.1)


def test_points_that_share_their_error_count_once_a_scene() -> None:
    # Every scene is wholly right or wholly wrong: its hundred points are one trial.
    successes = [100] * 36 + [0] * 4
    found, scenes = clustered_interval(successes, [100] * 40), wilson_interval(0.9, 40)
    assert found == pytest.approx(scenes, abs=0.005)


def test_scenes_that_show_no_variance_count_once_each() -> None:
    assert clustered_interval([50], [100]) == wilson_interval(0.5, 1)
    assert clustered_interval([100] * 5, [100] * 5) == wilson_interval(1.0, 5)
    assert clustered_interval([0, 100, 0], [0, 100, 0]) == wilson_interval(1.0, 1), "scenes without a point say nothing"
