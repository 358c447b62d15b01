"""Residual distortion: sign, size and sigma of the distortion that remains in the corners."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import N_CORRECTIONS, stack_corners
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.noise import NoisePriors
from calibration.solver.outlier_rejection import keep_consistent_views
from calibration.solver.problem import Problem, Unknowns
from calibration.solver.residual_distortion import ResidualDistortion, estimate_residual_distortion
from tests.calibration.board_views import Noise, Recorded, realistic_plan, record


def residual_of(recorded: Recorded, k1: float) -> ResidualDistortion:
    """Return the residual distortion of images distorted by `k1`, starting at the true calibration."""
    corners = stack_corners(recorded.observations)
    rays = (corners.pixels - corners.K[:2, 2]) / corners.K[[0, 1], [0, 1]]
    bent = rays * (1 + k1 * (rays**2).sum(axis=2, keepdims=True)) * corners.K[[0, 1], [0, 1]] + corners.K[:2, 2]
    corners = replace(corners, pixels=np.where(corners.seen[..., None], bent, 0.0))
    problem = Problem(corners, recorded.T_base_flange, recorded.observations.mounting, NoisePriors())
    board_poses = estimate_board_poses(corners)
    start = Unknowns(recorded.X, recorded.Y, np.zeros((len(board_poses.found), 6)), np.zeros(N_CORRECTIONS))
    adjusted = adjust(problem, start, board_poses.found, board_poses.inliers, problem.priors.noise)
    solution = keep_consistent_views(problem, board_poses, adjusted)
    return estimate_residual_distortion(problem, solution.adjusted)


@pytest.mark.parametrize("k1", [-0.1, -0.03, 0.03, 0.1])
def test_the_distortion_is_estimated_from_the_residuals(k1: float) -> None:
    found = residual_of(record(2, 12, plan=realistic_plan), k1)
    # The neglected next order is about a tenth of it.
    assert found.k1 == pytest.approx(k1, rel=0.2, abs=3 * found.sigma)
    assert abs(found.k1) > 6 * found.sigma


def test_errors_of_the_camera_matrix_are_not_taken_for_distortion() -> None:
    noise = Noise(focal=0.003, centre_px=(1.5, -1.0), scale=0.002)
    for k in range(8):
        found = residual_of(record(k, 12, noise, realistic_plan), 0.0)
        assert abs(found.k1) < 4.5 * found.sigma
        assert found.sigma < 0.006
