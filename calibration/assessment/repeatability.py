"""Repeatability of a scan: how far its views disagree due to errors of calibration and robot."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import cross_matrix

VIEWS = 8
"""Number of views of a scan."""
ELEVATIONS_RAD = np.radians([50.0, 70.0])
"""Elevations of the two rings on which the views alternate."""
ROLLS_RAD = np.radians([15.0, -15.0, -15.0, 15.0])
"""Roll of the views, repeated over the ring."""
DRAWS = 2000
"""Number of random scans."""
PERCENTILE = 95.0
"""Percentile of the largest disagreement in a scan that is reported."""


def repeatability_bound(
    covariance: NDArray[np.float64],
    robot_sigma_rad: float,
    robot_sigma_m: float,
    distance_m: float,
    lever: NDArray[np.float64],
) -> float:
    """Return the 95th percentile over scans of the largest disagreement between two of eight views, metres.

    It is a Monte Carlo estimate with fixed random numbers, at the point that all views look at.

    Args:
        covariance: (6, 6) covariance of X as in `HandEyeResult`.
        robot_sigma_rad: Noise of the flange rotations about one axis, one sigma.
        robot_sigma_m: Noise of the flange positions along one axis, one sigma.
        distance_m: Distance of the point from the camera.
        lever: (3,) vector from the flange to the point along the axes of the camera, metres.
    """
    rng = np.random.default_rng(0)
    # By eigenvectors, since the covariance may be nearly singular.
    values, vectors = np.linalg.eigh(covariance)
    X_errors = rng.normal(size=(DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    robot_errors = rng.normal(size=(DRAWS, VIEWS, 6)) * np.repeat([robot_sigma_rad, robot_sigma_m], 3)

    R = _rings()
    point = np.array([0.0, 0.0, distance_m])
    J_X = np.concatenate([-cross_matrix(point), np.eye(3)], axis=1)
    # The noise of the robot is isotropic, so the axes of the camera serve for those of the flange.
    J_robot = np.concatenate([-cross_matrix(lever), np.eye(3)], axis=1)
    displacements = (X_errors @ J_X.T)[:, None] + robot_errors @ J_robot.T
    points = (R @ displacements[..., None])[..., 0]
    first, second = np.triu_indices(VIEWS, k=1)
    squares = ((points[:, first] - points[:, second]) ** 2).sum(axis=2)
    return float(np.sqrt(np.percentile(squares.max(axis=1), PERCENTILE)))


def _rings() -> NDArray[np.float64]:
    """Return the rotations (VIEWS, 3, 3) of the cameras in the base frame, with z towards the point."""
    from scipy.spatial.transform import Rotation

    k = np.arange(VIEWS)
    azimuth, elevation = 2 * np.pi * k / VIEWS, ELEVATIONS_RAD[k % 2]
    z = -np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    upright = np.stack([x, np.cross(z, x), z], axis=2)
    return upright @ Rotation.from_euler("z", ROLLS_RAD[k % 4, None]).as_matrix()
