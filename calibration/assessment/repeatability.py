"""Repeatability of a scan: disagreement of its views due to errors of the calibration and the robot."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import cross_matrix

VIEWS = 8
"""Number of views of a scan."""
ELEVATIONS_RAD = np.radians([50.0, 70.0])
"""Elevations of the two rings of viewpoints, radians. Consecutive views alternate between the rings."""
ROLLS_RAD = np.radians([15.0, -15.0, -15.0, 15.0])
"""Rolls of consecutive views about the optical axis, radians. The sequence repeats after four views."""
DRAWS = 2000
"""Number of simulated scans."""
PERCENTILE = 95.0
"""Percentile of the largest disagreement in a scan, over all simulated scans."""


def estimate_repeatability(
    covariance: NDArray[np.float64],
    robot_sigma_rad: float,
    robot_sigma_m: float,
    distance_m: float,
    lever: NDArray[np.float64],
) -> float:
    """Estimate the repeatability of a scan, metres, by a Monte Carlo simulation with fixed random numbers.

    The optical axes of all eight views of a scan intersect at one point. Two views disagree by the distance between the
    positions that the two views give for this point. The repeatability is the 95th percentile of the largest
    disagreement in a scan.

    Args:
        covariance: (6, 6) covariance of the error of X, as `HandEyeResult.covariance`.
        robot_sigma_rad: Standard deviation of the robot rotation error per axis, radians.
        robot_sigma_m: Standard deviation of the robot position error per axis, metres.
        distance_m: Distance of the point from the camera, metres.
        lever: (3,) vector from the flange to the point in camera axes, metres.
    """
    rng = np.random.default_rng(0)
    # Draw along the eigenvectors, because the covariance may be nearly singular.
    values, vectors = np.linalg.eigh(covariance)
    X_errors = rng.normal(size=(DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    robot_errors = rng.normal(size=(DRAWS, VIEWS, 6)) * np.repeat([robot_sigma_rad, robot_sigma_m], 3)

    R = _rings()
    point = np.array([0.0, 0.0, distance_m])
    J_X = np.concatenate([-cross_matrix(point), np.eye(3)], axis=1)
    # The robot errors are isotropic, so they can be drawn in camera axes instead of flange axes.
    J_robot = np.concatenate([-cross_matrix(lever), np.eye(3)], axis=1)
    displacements = (X_errors @ J_X.T)[:, None] + robot_errors @ J_robot.T
    points = (R @ displacements[..., None])[..., 0]
    first, second = np.triu_indices(VIEWS, k=1)
    squares = ((points[:, first] - points[:, second]) ** 2).sum(axis=2)
    return float(np.sqrt(np.percentile(squares.max(axis=1), PERCENTILE)))


def _rings() -> NDArray[np.float64]:
    """Return the camera rotations (VIEWS, 3, 3) in the base frame, with z towards the point."""
    from scipy.spatial.transform import Rotation

    k = np.arange(VIEWS)
    azimuth = 2 * np.pi * k / VIEWS
    elevation = ELEVATIONS_RAD[k % 2]
    z = -np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    upright = np.stack([x, np.cross(z, x), z], axis=2)
    return upright @ Rotation.from_euler("z", ROLLS_RAD[k % 4, None]).as_matrix()
