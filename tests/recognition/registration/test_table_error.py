"""The error that a given table plane may have, judged from what the views show of it."""

import numpy as np
import pytest

from recognition.registration.measured_table import MeasuredTable
from recognition.registration.table_error import WRONG_HEIGHT_M, WRONG_SHARE, WRONG_TILT_RAD, estimate_table_error

HEIGHT_SIGMA_M = 0.00046
"""Sigma of the height that eight views show."""
TILT_SIGMA_RAD = 0.0007
"""Sigma of the tilt that eight views show."""


def measured(height_m: float = 0.0, tilt_rad: tuple[float, float] = (0.0, 0.0), scale: float = 1.0) -> MeasuredTable:
    sigma = scale * np.array([TILT_SIGMA_RAD, TILT_SIGMA_RAD, HEIGHT_SIGMA_M])
    return MeasuredTable(np.zeros(3), np.array([*tilt_rad, height_m]), np.diag(sigma**2))


def test_a_plane_that_the_views_confirm_has_nearly_no_error() -> None:
    error = estimate_table_error(measured())
    assert error.probability < WRONG_SHARE
    # less than a quarter of the sigma of a scan with eight views, which is 0.2 mm
    assert np.sqrt(error.covariance[2, 2]) < 0.00005
    assert np.sqrt(error.covariance[0, 0]) < 0.0001


@pytest.mark.parametrize("height_m", [0.0019, -0.0019])
def test_a_height_that_differs_much_is_wholly_in_the_error(height_m: float) -> None:
    error = estimate_table_error(measured(height_m))
    assert error.probability > 0.9
    assert np.sqrt(error.covariance[2, 2]) == pytest.approx(abs(height_m), rel=0.1)
    assert error.covariance[0, 0] < TILT_SIGMA_RAD**2


def test_a_tilt_about_one_axis_is_in_the_error_of_this_axis() -> None:
    error = estimate_table_error(measured(tilt_rad=(0.0, 0.004)))
    assert error.probability > 0.9
    assert np.sqrt(error.covariance[1, 1]) == pytest.approx(0.004, rel=0.1)
    assert error.covariance[1, 1] > 10 * error.covariance[0, 0]
    assert np.sqrt(error.covariance[2, 2]) < 0.00005


def test_the_error_grows_with_the_difference() -> None:
    errors = [estimate_table_error(measured(height_m)) for height_m in np.linspace(0.0, 0.004, 41)]
    assert np.all(np.diff([error.probability for error in errors]) > 0)
    assert np.all(np.diff([error.covariance[2, 2] for error in errors]) > 0)


def test_the_same_difference_counts_less_if_the_poses_are_less_certain() -> None:
    certain, uncertain = (estimate_table_error(measured(0.0015, scale=scale)) for scale in (1.0, 3.0))
    assert certain.probability > 0.5 > 5 * uncertain.probability


def test_the_error_has_the_size_of_drawn_errors() -> None:
    """The mean of the expected squares is that of the true ones, if planes are drawn as the mixture assumes."""
    rng = np.random.default_rng(0)
    n = 20000
    is_off = rng.random((n, 2)) < WRONG_SHARE
    height = np.where(is_off[:, 0], WRONG_HEIGHT_M * rng.standard_normal(n), 0.0)
    tilt = np.where(is_off[:, 1:], WRONG_TILT_RAD * rng.standard_normal((n, 2)), 0.0)
    shown = np.column_stack([tilt, height]) + rng.standard_normal((n, 3)) * (
        TILT_SIGMA_RAD,
        TILT_SIGMA_RAD,
        HEIGHT_SIGMA_M,
    )
    errors = [estimate_table_error(measured(z, (x, y))) for x, y, z in shown]
    expected = np.mean([np.diag(error.covariance) for error in errors], axis=0)
    true = np.mean(np.column_stack([tilt, height]) ** 2, axis=0)
    # 600 planes are off on average; the mean of their squares has a relative error of sqrt(2 / 600) = 6 %
    np.testing.assert_allclose(expected, true, rtol=0.2)
