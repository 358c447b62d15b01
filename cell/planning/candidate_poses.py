"""Candidate poses of each viewpoint: the preferred pose, and alternatives in case the arm cannot reach it."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.config.camera_optics import CameraOptics
from cell.config.cell_config import CellSettings
from cell.config.strict_model import Range
from cell.planning.look_at import Bearing, least_distance, look_at, two_rings

_ROLLS_RAD = np.deg2rad((0, 15, -15, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180))
_NEARER_M = (0.0, -0.06, 0.06)
_HIGHER_RAD = np.deg2rad((0.0, 10.0, -10.0, 20.0))
_STEEPEST_RAD = np.deg2rad(85.0)
_ASIDE_RAD = np.deg2rad((0.0, 12.0, -12.0))


@dataclass(frozen=True, eq=False)
class Sight:
    """The target, and the camera that looks at it."""

    target: NDArray[np.float64]
    """Middle of the workspace's floor (3,), base frame."""
    corners: NDArray[np.float64]
    """Points (N, 3) on the floor that must be in the image, relative to the middle."""
    optics: CameraOptics
    """Optics of the camera."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) camera pose on the flange."""

    @staticmethod
    def of(settings: CellSettings, optics: CameraOptics, T_flange_camera: NDArray[np.float64]) -> "Sight":
        """Return the sight of the floor of a cell's workspace."""
        (x0, x1), (y0, y1), (floor, _) = settings.workspace_m
        target = np.array([(x0 + x1) / 2, (y0 + y1) / 2, floor])
        corners = np.array([(x, y, floor) for x in (x0, x1) for y in (y0, y1)]) - target
        return Sight(target, corners, optics, T_flange_camera)

    def least_distance(self, bearing: Bearing) -> float:
        """Return the smallest distance from which all corners are in the image, metres."""
        size = (self.optics.width, self.optics.height)
        return least_distance(self.corners, self.optics.K, size, self.optics.near_m, bearing)


@dataclass(frozen=True, eq=False)
class PoseToTry:
    """A candidate pose of the camera, with the flange pose."""

    azimuth_rad: float
    """Azimuth of the camera, seen from the target."""
    elevation_rad: float
    """Elevation of the camera above the table."""
    distance_m: float
    """Distance of the camera from the target."""
    roll_rad: float
    """Roll about the optical axis."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose."""
    fallback: str | None
    """How the pose differs from the preferred one, or None."""


def poses_to_try(sight: Sight, views: int) -> list[Iterator[list[PoseToTry]]]:
    """Return the candidate poses of each view of a scan, as `tries` gives them."""
    return [_tries_of_view(sight, bearing) for bearing in two_rings(views)]


def tries(sight: Sight, bearing: Bearing, wanted_m: float, within_m: Range) -> Iterator[list[PoseToTry]]:
    """Yield lists of candidate poses for one view, the best first.

    The first list has only the preferred pose. Later lists change the roll, then also the distance, then also the
    elevation and the azimuth.

    Args:
        sight: Target and camera.
        bearing: Preferred direction of the camera.
        wanted_m: Preferred distance.
        within_m: Smallest and largest distance.
    """
    nearest, farthest = within_m
    distances = [wanted_m + nearer for nearer in _NEARER_M if nearest - 1e-9 <= wanted_m + nearer <= farthest + 1e-9]
    yield [_pose(sight, bearing, wanted_m, (0.0, 0.0, wanted_m, 0.0))]
    for aside, higher in itertools.product(_ASIDE_RAD, _HIGHER_RAD):
        if bearing.elevation_rad + higher > _STEEPEST_RAD:
            continue
        changes = [(aside, higher, distance, roll) for distance in distances for roll in _ROLLS_RAD]
        if not (aside or higher):  # the distance is changed after the roll
            yield [_pose(sight, bearing, wanted_m, change) for change in changes[1 : len(_ROLLS_RAD)]]
            changes = changes[len(_ROLLS_RAD) :]
        if changes:
            yield [_pose(sight, bearing, wanted_m, change) for change in changes]


def _tries_of_view(sight: Sight, bearing: Bearing) -> Iterator[list[PoseToTry]]:
    wanted = float(np.clip(sight.least_distance(bearing), *sight.optics.working_m))
    return tries(sight, bearing, wanted, sight.optics.working_m)


def _pose(sight: Sight, bearing: Bearing, wanted_m: float, changes: tuple[float, float, float, float]) -> PoseToTry:
    aside, higher, distance, roll = changes
    nearer = distance - wanted_m
    azimuth, elevation = float(bearing.azimuth_rad + aside), float(bearing.elevation_rad + higher)
    T_base_camera = look_at(sight.target, azimuth, elevation, distance, bearing.roll_rad + roll)
    words = [
        f"rolled by {np.rad2deg(roll):+.0f} deg" if roll else "",
        f"{abs(nearer) * 100:.0f} cm {'nearer' if nearer < 0 else 'farther'}" if nearer else "",
        f"{abs(np.rad2deg(higher)):.0f} deg {'higher' if higher > 0 else 'lower'}" if higher else "",
        f"{np.rad2deg(aside):+.0f} deg round" if aside else "",
    ]
    return PoseToTry(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        distance_m=distance,
        roll_rad=bearing.roll_rad + roll,
        T_base_camera=T_base_camera,
        T_base_flange=T_base_camera @ inverse(sight.T_flange_camera),
        fallback=", ".join(word for word in words if word) or None,
    )
