"""Viewpoints of a simulated scan, and the errors of the reported poses."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.planning.look_at import Bearing, look_at, min_distance, two_rings
from cell.simulation.kinematic_error import KinematicError

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
"""Mounting of the simulated camera, without errors. It is oblique, so that a wrong order of transforms shows."""


@dataclass(frozen=True)
class PoseErrors:
    """Root mean square errors of the reported poses. Each error has a random direction."""

    robot_m: float = 0.0005
    """Error of the flange's position, independent for each view."""
    robot_rad: float = float(np.deg2rad(0.1))
    """Error of the flange's orientation, independent for each view."""
    hand_eye_m: float = 0.0007
    """Error of the position in the hand-eye calibration, once for each scan."""
    hand_eye_rad: float = float(np.deg2rad(0.15))
    """Error of the orientation in the hand-eye calibration, once for each scan."""
    smooth_m: float = 0.0
    """Root mean square of a further error of the reported position, which changes smoothly with the pose."""
    smooth_rad: float = 0.0
    """Root mean square of a further error of the reported orientation, which changes smoothly with the pose."""

    def scaled(self, factor: float) -> "PoseErrors":
        """Return all errors multiplied by a factor."""
        return PoseErrors(*(factor * value for value in astuple(self)))


NO_ERRORS = PoseErrors(0.0, 0.0, 0.0, 0.0)


def viewpoints(
    points: NDArray[np.float64],
    K: NDArray[np.float64],
    size: tuple[int, int],
    near_m: float,
    working_m: tuple[float, float],
    views: int,
    bearings: Sequence[Bearing] | None = None,
) -> list[NDArray[np.float64]]:
    """Return `T_base_camera` of viewpoints around the origin, on two rings in turn.

    All viewpoints have the smallest distance within `working_m` from which every camera sees all points, or the largest
    one if none suffices.

    Args:
        points: Points (N, 3) that must be within the middle `FILL` of each image.
        K: Pinhole matrix (3, 3), pixels.
        size: Width and height of the image, pixels.
        near_m: Smallest distance of a point.
        working_m: Smallest and largest distance of the camera.
        views: Number of viewpoints.
        bearings: Bearing of each viewpoint. None means bearings on two rings.
    """
    bearings = two_rings(views) if bearings is None else bearings
    needed = max(min_distance(points, K, size, near_m, bearing) for bearing in bearings)
    distance = min(max(working_m[0], needed), working_m[1])
    return [look_at(np.zeros(3), b.azimuth_rad, b.elevation_rad, distance, b.roll_rad) for b in bearings]


def reported_flange_poses(
    T_base_camera: Sequence[NDArray[np.float64]],
    T_flange_camera: NDArray[np.float64],
    errors: PoseErrors,
    rng: np.random.Generator,
    seed: int = 0,
) -> list[NDArray[np.float64]]:
    """Return the `T_base_flange` that the robot reports for the true camera poses.

    Args:
        T_base_camera: True camera poses (4, 4).
        T_flange_camera: True mounting of the camera (4, 4).
        errors: Sizes of the errors.
        rng: Generator of the independent errors.
        seed: Seed of the arm with the smooth error.
    """
    smooth = KinematicError(errors.smooth_m, errors.smooth_rad, seed)
    T_base_flange = [T @ inverse(T_flange_camera) for T in T_base_camera]
    if errors.smooth_m > 0 or errors.smooth_rad > 0:
        T_base_flange = [smooth.apply(T) for T in T_base_flange]
    return [perturbed(T, errors.robot_m, errors.robot_rad, rng) for T in T_base_flange]


def perturbed(
    T: NDArray[np.float64], error_m: float, error_rad: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return `T` with a random translation and a random rotation about its own origin, of these root mean squares."""
    shift, turn = rng.standard_normal((2, 3)) / np.sqrt(3.0)
    error = from_rotation_vector(error_m * shift, error_rad * turn)
    result = np.eye(4)
    result[:3, :3] = error[:3, :3] @ T[:3, :3]
    result[:3, 3] = T[:3, 3] + error[:3, 3]
    return result
