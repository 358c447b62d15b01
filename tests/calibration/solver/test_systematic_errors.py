"""Systematic errors: smooth errors of the arm, and errors that neighbouring corners share."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import inverse
from calibration.hand_eye import solve_hand_eye
from calibration.observations import Observations
from calibration.solver.noise import NoisePriors
from calibration.solver.smooth_errors import smooth_modes
from cell.simulation.kinematic_error import KinematicError
from tests.calibration.board_views import K, Recorded, realistic_plan, record
from tests.calibration.test_hand_eye_accuracy import by_park

NOMINAL = NoisePriors(focal=1e-5, centre=1e-5, scale=1e-5)
"""Priors of an exactly known camera and board, as closed forms assume."""


def with_smooth_errors(seed: int, rms_m: float, rms_deg: float) -> Recorded:
    """Return 15 to 25 views by an arm whose reported poses are off smoothly, besides independent noise."""
    recorded = record(seed, 15 + seed % 11, plan=realistic_plan)
    arm = KinematicError(rms_m, float(np.radians(rms_deg)), 1000 + seed)
    views = [replace(view, T_base_flange=arm.apply(view.T_base_flange)) for view in recorded.observations.views]
    return replace(recorded, observations=replace(recorded.observations, views=tuple(views)))


def with_bent_images(observations: Observations, size_px: float) -> Observations:
    """Return observations whose corners are shifted by a smooth pattern of the image that no distortion model has."""

    def bend(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = ((pixels - K[:2, 2]) / 300).T
        return pixels + size_px * np.column_stack([np.sin(2.5 * x), np.sin(2.5 * y)])

    return replace(observations, views=tuple(replace(view, pixels=bend(view.pixels)) for view in observations.views))


def error_twist(X: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the error of `X` (6,), radians and metres."""
    difference = inverse(X) @ truth
    return np.concatenate([Rotation.from_matrix(difference[:3, :3]).as_rotvec(), difference[:3, 3]])


@pytest.mark.slow
@pytest.mark.parametrize(("rms_m", "rms_deg"), [(3e-4, 0.1), (1.2e-3, 0.2)])
@pytest.mark.parametrize("count", [12, pytest.param(40, marks=pytest.mark.soak)])
def test_the_covariance_agrees_with_the_errors_by_a_smooth_arm_error(count: int, rms_m: float, rms_deg: float) -> None:
    recorded = [with_smooth_errors(seed, rms_m, rms_deg) for seed in range(count)]
    results = [solve_hand_eye(each.observations, NOMINAL) for each in recorded]
    pairs = list(zip(recorded, results, strict=True))
    rms = np.sqrt(np.mean([error_twist(result.X, each.X) ** 2 for each, result in pairs], axis=0))
    sigma = np.sqrt(np.mean([np.diag(result.covariance) for result in results], axis=0))
    # The root mean square of 12 values scatters by 20 %.
    assert (rms < (1.5 if count >= 40 else 1.7) * sigma).all()
    park = np.sqrt(np.mean([error_twist(by_park(each), each.X) ** 2 for each in recorded], axis=0))
    assert np.linalg.norm(rms[3:]) < np.linalg.norm(park[3:])
    assert np.linalg.norm(rms[:3]) < 1.1 * np.linalg.norm(park[:3])


@pytest.mark.parametrize("seed", range(3))
def test_a_pattern_of_the_corners_moves_the_focal_length_less_than_independent_noise(seed: int) -> None:
    recorded = record(seed, 20, plan=realistic_plan)
    result = solve_hand_eye(with_bent_images(recorded.observations, 1.5))
    # An adjustment that takes the shifts for independent noise is off by 1.2 to 1.5 %.
    assert np.abs(result.K.diagonal()[:2] / K.diagonal()[:2] - 1).max() < 0.0115
    assert "not-settled" not in {finding.code for finding in result.findings}


def test_modes_are_the_roots_of_the_correlation() -> None:
    T = record(3, 15).T_base_flange
    modes = smooth_modes(T)
    covariance = modes @ modes.swapaxes(1, 2)
    # Each pose has variance one in each component, but for the modes that are left out.
    np.testing.assert_allclose(covariance, np.broadcast_to(np.eye(6), (15, 6, 6)), atol=0.05)
    assert modes.shape[2] % 6 == 0
