"""Camera poses that look at a point on the table, and their necessary distance."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ELEVATIONS_RAD = (np.deg2rad(50.0), np.deg2rad(70.0))
"""Elevations of the two rings of viewpoints above the table."""
ROLL_RAD = np.deg2rad(15.0)
"""Roll of the views in both directions. A string along the baseline in one view lies across it in another."""
FILL = 0.9
"""Share of the image, around its middle, that must contain the target."""


@dataclass(frozen=True)
class Bearing:
    """Direction from which a camera looks at its target, without the distance."""

    azimuth_rad: float
    """Azimuth of the camera, seen from the target, about z from x."""
    elevation_rad: float
    """Elevation of the camera above the horizon of the target, less than pi/2."""
    roll_rad: float
    """Roll of the camera about its optical axis. Without roll, the x axis of the image is horizontal."""


def look_at(
    target: NDArray[np.float64], azimuth_rad: float, elevation_rad: float, distance_m: float, roll_rad: float
) -> NDArray[np.float64]:
    """Return `T_base_camera` (4, 4) of a camera that looks at a target.

    Args:
        target: Target (3,), base frame.
        azimuth_rad: Azimuth of the camera, seen from the target, about z from x.
        elevation_rad: Elevation of the camera above the horizon, less than pi/2.
        distance_m: Distance of the camera from the target.
        roll_rad: Roll about the optical axis. Without roll, the x axis of the image is horizontal.
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


def two_rings(views: int) -> list[Bearing]:
    """Return bearings evenly around the target, on two rings in turn, rolled in both directions."""
    return [
        Bearing(2 * np.pi * k / views, ELEVATIONS_RAD[k % 2], ROLL_RAD * (1, -1, -1, 1)[k % 4]) for k in range(views)
    ]


def ring_indices(views: int) -> tuple[range, range]:
    """Return the indices of the bearings of `two_rings` on the lower and on the upper ring."""
    return range(0, views, 2), range(1, views, 2)


def min_distance(
    points: NDArray[np.float64], K: NDArray[np.float64], size: tuple[int, int], near_m: float, bearing: Bearing
) -> float:
    """Return the smallest distance from the origin at which a camera that looks at it sees all points.

    Args:
        points: Points (N, 3), which must lie within the middle `FILL` of the image.
        K: Pinhole matrix (3, 3), pixels.
        size: Width and height of the image, pixels.
        near_m: Smallest distance of a point from the camera.
        bearing: Direction of the camera.
    """
    local = points @ look_at(np.zeros(3), bearing.azimuth_rad, bearing.elevation_rad, 0.0, bearing.roll_rad)[:3, :3]
    needed = 1.05 * near_m - float(local[:, 2].min())
    for axis in range(2):
        half = FILL * size[axis] / 2 / K[axis, axis]
        needed = max(needed, float((np.abs(local[:, axis]) / half - local[:, 2]).max()))
    return needed
