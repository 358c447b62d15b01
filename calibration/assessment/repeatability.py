"""How far two views of a scan will disagree because of the calibration and of the robot: what it means for a user."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import cross_matrix

VIEWS = 8
ELEVATIONS_RAD = np.radians([50.0, 70.0])
"""A scan's views stand on two rings, taking turns ..."""
ROLLS_RAD = np.radians([15.0, -15.0, -15.0, 15.0])
"""... and are rolled either way."""
DRAWS = 2000
SHARE = 95.0


def repeatability_bound(
    covariance: NDArray[np.float64],
    robot_sigma_rad: float,
    robot_sigma_m: float,
    distance_m: float,
    lever: NDArray[np.float64],
) -> float:
    """Metres: in 95 % of scans no two of eight views see the point they look at farther apart.

    Drawn, always with the same random numbers, from X's `covariance` (6, 6) as in `HandEyeResult`, and from the robot's
    noise along and about one axis. The point is `distance_m` before the camera, and `lever` (3,)
    from the flange, along the camera's axes.
    """
    rng = np.random.default_rng(0)
    # A covariance on the verge of losing rank is drawn from by its eigenvectors.
    values, vectors = np.linalg.eigh(covariance)
    of_X = rng.normal(size=(DRAWS, 6)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    of_robot = rng.normal(size=(DRAWS, VIEWS, 6)) * np.repeat([robot_sigma_rad, robot_sigma_m], 3)

    R = _rings()
    point = np.array([0.0, 0.0, distance_m])
    by_motion = np.concatenate([-cross_matrix(point), np.eye(3)], axis=1)
    # The robot's noise is alike about all axes, so that the camera's serve for the flange's.
    by_robot = np.concatenate([-cross_matrix(lever), np.eye(3)], axis=1)
    moved = (of_X @ by_motion.T)[:, None] + of_robot @ by_robot.T
    places = (R @ moved[..., None])[..., 0]
    first, second = np.triu_indices(VIEWS, k=1)
    squares = ((places[:, first] - places[:, second]) ** 2).sum(axis=2)
    return float(np.sqrt(np.percentile(squares.max(axis=1), SHARE)))


def _rings() -> NDArray[np.float64]:
    """(VIEWS, 3, 3) the cameras' directions in the base: z at the point looked at."""
    from scipy.spatial.transform import Rotation

    k = np.arange(VIEWS)
    azimuth, elevation = 2 * np.pi * k / VIEWS, ELEVATIONS_RAD[k % 2]
    z = -np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    upright = np.stack([x, np.cross(z, x), z], axis=2)
    return upright @ Rotation.from_euler("z", ROLLS_RAD[k % 4, None]).as_matrix()
