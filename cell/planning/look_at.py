"""Camera poses that look at a place on the table, and how far off they must be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ELEVATIONS_RAD = (np.deg2rad(50.0), np.deg2rad(70.0))
"""Of the two rings of viewpoints, above the table."""
ROLL_RAD = np.deg2rad(15.0)
"""Views are rolled by this much either way: a string along the baseline in one view lies across it in another."""
FILL = 0.9
"""Share of the image, from its middle, in which what is looked at must lie."""


@dataclass(frozen=True)
class Bearing:
    """From where a camera looks at its target, but for the distance."""

    azimuth_rad: float
    """Of the camera, seen from the target, about z from x."""
    elevation_rad: float
    """Of the camera above the target's horizon, less than pi/2."""
    roll_rad: float
    """Of the camera about its optical axis; without, the image's x axis is level."""


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


def two_rings(views: int) -> list[Bearing]:
    """Bearings evenly round the target, on two rings in turn, rolled either way."""
    return [
        Bearing(2 * np.pi * k / views, ELEVATIONS_RAD[k % 2], ROLL_RAD * (1, -1, -1, 1)[k % 4]) for k in range(views)
    ]


def least_distance(
    points: NDArray[np.float64], K: NDArray[np.float64], size: tuple[int, int], near_m: float, bearing: Bearing
) -> float:
    """The least distance from the origin at which a camera looking at it sees all `points` (N, 3).

    They lie within the middle `FILL` of its image of `size` (width, height), and none is nearer than `near_m`.
    """
    local = points @ look_at(np.zeros(3), bearing.azimuth_rad, bearing.elevation_rad, 0.0, bearing.roll_rad)[:3, :3]
    needed = 1.05 * near_m - float(local[:, 2].min())
    for axis in range(2):
        half = FILL * size[axis] / 2 / K[axis, axis]
        needed = max(needed, float((np.abs(local[:, axis]) / half - local[:, 2]).max()))
    return needed
