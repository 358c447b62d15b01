"""Compare the confidence intervals with SciPy, and with clusters whose interval is known."""

import numpy as np
import pytest
from scipy.stats import binomtest

from cell.simulation.benchmark.intervals import clustered_interval, wilson_interval


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (40, 40), (37, 40), (3, 6), (0, 12), (979, 1000)])
def test_the_interval_equals_the_wilson_interval_of_scipy(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes / trials, trials) == pytest.approx((expected.low, expected.high), abs=6e-5)


def test_without_trials_the_interval_is_none() -> None:
    assert wilson_interval(0.0, 0) is None
    assert clustered_interval([], []) is None
    assert clustered_interval([0, 0], [0, 0]) is None


def test_independent_points_have_the_wilson_interval_of_their_number() -> None:
    rng = np.random.default_rng(1)
    successes = rng.binomial(100, 0.9, size=400)
    found = clustered_interval(successes.tolist(), [100] * 400)
    expected = wilson_interval(successes.sum() / 40_000, 40_000)
    assert found is not None
    assert expected is not None
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=0.1)


def test_scenes_with_equal_points_count_as_one_trial_each() -> None:
    # The hundred points of a scene are all right or all wrong, so each scene is one trial.
    successes = [100] * 36 + [0] * 4
    found, scenes = clustered_interval(successes, [100] * 40), wilson_interval(0.9, 40)
    assert found == pytest.approx(scenes, abs=0.005)


def test_scenes_without_variance_count_as_one_trial_each() -> None:
    assert clustered_interval([50], [100]) == wilson_interval(0.5, 1)
    assert clustered_interval([100] * 5, [100] * 5) == wilson_interval(1.0, 5)
    assert clustered_interval([0, 100, 0], [0, 100, 0]) == wilson_interval(1.0, 1), "scenes without points do not count"
