"""The predicted disagreement of eight views, compared with simulated scans."""

import numpy as np
import pytest

from calibration.assessment.repeatability import VIEWS, estimate_repeatability
from calibration.geometry.se3 import invert_poses, pose_from_twist
from tests.calibration.board_views import look_at


def test_without_errors_there_is_no_disagreement() -> None:
    assert estimate_repeatability(np.zeros((6, 6)), 0.0, 0.0, 0.4, np.array([0, 0, 0.5])) == 0.0


def test_the_disagreement_grows_with_the_errors() -> None:
    covariance = np.diag([1e-8, 1e-8, 1e-8, 1e-8, 1e-8, 1e-8])
    lever = np.array([0.0, 0.0, 0.5])
    single = estimate_repeatability(covariance, 1e-4, 1e-4, 0.4, lever)
    assert estimate_repeatability(4 * covariance, 2e-4, 2e-4, 0.4, lever) == pytest.approx(2 * single)


def test_the_prediction_bounds_19_of_20_scans() -> None:
    rng = np.random.default_rng(1)
    X = pose_from_twist(np.array([0.1, -0.2, 0.5, 0.03, -0.05, 0.06]))
    root = rng.normal(size=(6, 6)) * np.array([3e-4] * 3 + [1e-4] * 3)[:, None]
    covariance, robot = root @ root.T, np.array([3e-4] * 3 + [1e-4] * 3)
    distance = 0.42
    # The same rings, as tilts from the vertical.
    cameras = np.array(
        [
            look_at(
                np.radians(40 - 20 * (k % 2)), 2 * np.pi * k / VIEWS, np.radians((15, -15, -15, 15)[k % 4]), distance
            )
            for k in range(VIEWS)
        ]
    )
    point = np.array([0.0, 0.0, distance, 1.0])
    worst = []
    for _ in range(1500):
        X_found = X @ pose_from_twist(root @ rng.normal(size=6))
        flange = cameras @ invert_poses(X) @ invert_poses(pose_from_twist(rng.normal(size=(VIEWS, 6)) * robot))
        seen = (flange @ X_found @ point)[:, :3]
        worst.append(np.linalg.norm(seen[:, None] - seen, axis=2).max())
    lever = np.array([0, 0, distance]) + X[:3, :3].T @ X[:3, 3]
    bound = estimate_repeatability(covariance, robot[0], robot[3], distance, lever)
    # 1500 scans determine a share of 0.95 to 0.006. The prediction is sampled too.
    assert np.mean(np.array(worst) < bound) == pytest.approx(0.95, abs=0.02)
