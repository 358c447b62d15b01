"""Initial guess from poses with many outliers, and from degenerate poses."""

import numpy as np
import pytest

from calibration.geometry.se3 import pose_from_twist
from calibration.solver.initialisation import estimate_initial_guess
from tests.calibration.board_views import NOISE_FREE, Noise, error_of, record


def test_exact_poses_give_the_exact_solution() -> None:
    recorded = record(0, 9, NOISE_FREE)
    start = estimate_initial_guess(recorded.T_base_flange, recorded.T_camera_board)
    degrees, millimetres = error_of(start.X, recorded.X)
    # The small damping causes an error of some nanometres.
    assert degrees < 1e-6
    assert millimetres < 1e-4
    assert start.inliers.all()


@pytest.mark.parametrize("wrong", [1, 4, 7])
def test_wrong_poses_are_distinguished_from_right_ones(wrong: int) -> None:
    for seed in range(10):
        recorded = record(seed, 16)
        rng = np.random.default_rng(seed)
        which = rng.permutation(16)[:wrong]
        poses = recorded.T_base_flange
        poses[which] = poses[which] @ pose_from_twist(rng.normal(0, 0.1, (wrong, 6)))
        start = estimate_initial_guess(poses, recorded.T_camera_board)
        assert set(np.flatnonzero(~start.inliers)) >= set(which)
        assert start.inliers.sum() >= 16 - wrong - 3
        degrees, millimetres = error_of(start.X, recorded.X)
        # Board poses are exact here. The error is the noise of the robot, in a closed form from at least nine views.
        assert degrees < 0.2
        assert millimetres < 2.0


def test_coarse_poses_are_not_outliers() -> None:
    recorded = record(1, 20, Noise(robot_m=0.01, robot_rad=0.02))
    start = estimate_initial_guess(recorded.T_base_flange, recorded.T_camera_board)
    assert start.inliers.sum() >= 17


def test_degenerate_poses_give_a_proper_transform() -> None:
    recorded = record(2, 10)
    still = np.repeat(recorded.T_base_flange[:1], 10, axis=0)
    for poses in (still, recorded.T_base_flange[::-1]):
        X = estimate_initial_guess(poses, recorded.T_camera_board).X
        assert np.isfinite(X).all()
        assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)


def test_the_same_poses_give_the_same_solution() -> None:
    recorded = record(3, 20)
    first, second = (estimate_initial_guess(recorded.T_base_flange, recorded.T_camera_board).X for _ in range(2))
    assert np.array_equal(first, second)
