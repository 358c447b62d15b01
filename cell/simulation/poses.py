"""Where the simulated camera looks from, and how wrongly the arm and the calibration tell it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.transforms import from_rotation_vector, inverse

ELEVATIONS_RAD = (np.deg2rad(50.0), np.deg2rad(70.0))
"""Of the two rings of viewpoints, above the table."""
ROLL_RAD = np.deg2rad(15.0)
"""Views are rolled by this much either way: a string along the baseline in one view lies across it in another."""
FILL = 0.9
"""Share of the image, from its middle, in which the strings must lie."""

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
"""The simulated camera's mounting, before errors. Oblique, so that a wrong order of transforms shows."""


@dataclass(frozen=True)
class PoseErrors:
    """Root mean square errors of told against true poses; each is drawn evenly over the directions."""

    robot_m: float = 0.0005
    """Of the flange's place, anew in each view."""
    robot_rad: float = float(np.deg2rad(0.1))
    hand_eye_m: float = 0.0007
    """Of the calibration, once a scan."""
    hand_eye_rad: float = float(np.deg2rad(0.15))

    def scaled(self, factor: float) -> "PoseErrors":
        """All of them times a factor."""
        return PoseErrors(*(factor * e for e in (self.robot_m, self.robot_rad, self.hand_eye_m, self.hand_eye_rad)))


NO_ERRORS = PoseErrors(0.0, 0.0, 0.0, 0.0)


def look_at(
    target: NDArray[np.float64], azimuth_rad: float, elevation_rad: float, distance_m: float, roll_rad: float
) -> NDArray[np.float64]:
    """`T_base_camera` of a camera at that bearing and distance from `target` (3,), looking at it.

    Without roll the image's x axis is level. Elevation is above the horizon, less than pi/2.
    """
    back = np.array(
        [
            np.cos(elevation_rad) * np.cos(azimuth_rad),
            np.cos(elevation_rad) * np.sin(azimuth_rad),
            np.sin(elevation_rad),
        ]
    )
    level = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    down = np.cross(-back, level)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = c * level + s * down, c * down - s * level, -back
    T[:3, 3] = np.asarray(target) + distance_m * back
    return T


def viewpoints(
    points: NDArray[np.float64],
    K: NDArray[np.float64],
    size: tuple[int, int],
    near_m: float,
    working_m: tuple[float, float],
    views: int,
) -> list[NDArray[np.float64]]:
    """`T_base_camera` of look-at poses about the origin, on two rings in turn, evenly round it.

    All have one distance: the least within `working_m` from which each sees all `points` (N, 3) within the
    middle `FILL` of its image of `size` (width, height) and none nearer than `near_m`; the far end of it where
    none is enough.
    """
    bearings = [(2 * np.pi * k / views, ELEVATIONS_RAD[k % 2], ROLL_RAD * (1, -1, -1, 1)[k % 4]) for k in range(views)]
    needed = working_m[0]
    for azimuth, elevation, roll in bearings:
        local = points @ look_at(np.zeros(3), azimuth, elevation, 0.0, roll)[:3, :3]
        needed = max(needed, 1.05 * near_m - float(local[:, 2].min()))
        for axis in range(2):
            half = FILL * size[axis] / 2 / K[axis, axis]
            needed = max(needed, float((np.abs(local[:, axis]) / half - local[:, 2]).max()))
    distance = min(needed, working_m[1])
    return [look_at(np.zeros(3), *bearing[:2], distance, bearing[2]) for bearing in bearings]


def told_flange_poses(
    T_base_camera: Sequence[NDArray[np.float64]],
    T_flange_camera: NDArray[np.float64],
    errors: PoseErrors,
    rng: np.random.Generator,
) -> list[NDArray[np.float64]]:
    """The `T_base_flange` that the robot tells for true camera poses and the true mounting of the camera."""
    return [perturbed(T @ inverse(T_flange_camera), errors.robot_m, errors.robot_rad, rng) for T in T_base_camera]


def perturbed(
    T: NDArray[np.float64], error_m: float, error_rad: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """`T` moved and, about its own origin, turned by errors of these root mean square sizes."""
    shift, turn = rng.standard_normal((2, 3)) / np.sqrt(3.0)
    error = from_rotation_vector(error_m * shift, error_rad * turn)
    result = np.eye(4)
    result[:3, :3] = error[:3, :3] @ T[:3, :3]
    result[:3, 3] = T[:3, 3] + error[:3, 3]
    return result
