"""Candidate poses of each viewpoint: the preferred pose, and alternatives in case the arm cannot reach it."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.config.camera_optics import CameraOptics
from cell.config.cell_config import CellSettings
from cell.config.strict_model import Range
from cell.planning.look_at import Bearing, look_at, min_distance, two_rings

_ROLLS_RAD = np.deg2rad((0, 15, -15, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180))
_ROLL_FACTORS = (1.0, 2.0, 3.0)
"""Multiples of a bearing's roll that are compared, the preferred one first."""
_NEARER_M = (0.0, -0.06, 0.06)
_HIGHER_RAD = np.deg2rad((0.0, 10.0, -10.0, 20.0))
_STEEPEST_RAD = np.deg2rad(85.0)
_ASIDE_RAD = np.deg2rad((0.0, 12.0, -12.0))


@dataclass(frozen=True, eq=False)
class ViewTarget:
    """The target, and the camera that looks at it."""

    centre: NDArray[np.float64]
    """Middle of the workspace's floor (3,), base frame."""
    corners: NDArray[np.float64]
    """Points (N, 3) on the floor that must be in the image, relative to the middle."""
    optics: CameraOptics
    """Optics of the camera."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) camera pose on the flange."""

    @staticmethod
    def of(settings: CellSettings, optics: CameraOptics, T_flange_camera: NDArray[np.float64]) -> "ViewTarget":
        """Return the view target on the floor of a cell's workspace."""
        (x0, x1), (y0, y1), (floor, _) = settings.workspace_m
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, floor])
        corners = np.array([(x, y, floor) for x in (x0, x1) for y in (y0, y1)]) - centre
        return ViewTarget(centre, corners, optics, T_flange_camera)

    def min_distance(self, bearing: Bearing) -> float:
        """Return the smallest distance from which all corners are in the image, metres."""
        size = (self.optics.width, self.optics.height)
        return min_distance(self.corners, self.optics.K, size, self.optics.near_m, bearing)


@dataclass(frozen=True, eq=False)
class CandidatePose:
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


def scan_candidates(view_target: ViewTarget, views: int) -> list[Iterator[list[CandidatePose]]]:
    """Return the candidate poses of each view of a scan, as `candidate_levels` gives them."""
    bearings = two_rings(views)
    # With rolls of one sign on the upper ring, the baselines of neighbouring views are nearly perpendicular, also if
    # the rolls are larger.
    bearings[1::2] = [replace(bearing, roll_rad=-abs(bearing.roll_rad)) for bearing in bearings[1::2]]
    return [_view_candidates(view_target, bearing) for bearing in bearings]


def candidate_levels(
    view_target: ViewTarget, bearing: Bearing, preferred_m: float, range_m: Range
) -> Iterator[list[CandidatePose]]:
    """Yield lists of candidate poses for one view, the best first.

    The first list has only the preferred pose. Later lists change the roll, then also the distance, then also the
    elevation and the azimuth.

    Args:
        view_target: Target and camera.
        bearing: Preferred direction of the camera.
        preferred_m: Preferred distance.
        range_m: Smallest and largest distance.
    """
    nearest, farthest = range_m
    distances = [
        preferred_m + nearer for nearer in _NEARER_M if nearest - 1e-9 <= preferred_m + nearer <= farthest + 1e-9
    ]
    yield [_pose(view_target, bearing, preferred_m, (0.0, 0.0, preferred_m, 0.0))]
    for aside, higher in itertools.product(_ASIDE_RAD, _HIGHER_RAD):
        if bearing.elevation_rad + higher > _STEEPEST_RAD:
            continue
        changes = [(aside, higher, distance, roll) for distance in distances for roll in _ROLLS_RAD]
        if not (aside or higher):  # the distance is changed after the roll
            yield [_pose(view_target, bearing, preferred_m, change) for change in changes[1 : len(_ROLLS_RAD)]]
            changes = changes[len(_ROLLS_RAD) :]
        if changes:
            yield [_pose(view_target, bearing, preferred_m, change) for change in changes]


def _view_candidates(view_target: ViewTarget, bearing: Bearing) -> Iterator[list[CandidatePose]]:
    """Return the candidate poses of one view, with the roll at which the camera can be nearest to the target.

    A workspace seen over its corner fills the image from nearer if the camera is rolled along its sides. Depth noise
    grows with the square of the distance.
    """
    working_m = view_target.optics.working_m
    rolled = [replace(bearing, roll_rad=factor * bearing.roll_rad) for factor in _ROLL_FACTORS]
    distances = np.clip([view_target.min_distance(one) for one in rolled], *working_m)
    nearest = int(np.argmin(distances.round(6)))
    return candidate_levels(view_target, rolled[nearest], float(distances[nearest]), working_m)


def _pose(
    view_target: ViewTarget, bearing: Bearing, preferred_m: float, changes: tuple[float, float, float, float]
) -> CandidatePose:
    aside, higher, distance, roll = changes
    nearer = distance - preferred_m
    azimuth, elevation = float(bearing.azimuth_rad + aside), float(bearing.elevation_rad + higher)
    T_base_camera = look_at(view_target.centre, azimuth, elevation, distance, bearing.roll_rad + roll)
    parts = [
        f"rolled by {np.rad2deg(roll):+.0f} deg" if roll else "",
        f"{abs(nearer) * 100:.0f} cm {'nearer' if nearer < 0 else 'farther'}" if nearer else "",
        f"{abs(np.rad2deg(higher)):.0f} deg {'higher' if higher > 0 else 'lower'}" if higher else "",
        f"{np.rad2deg(aside):+.0f} deg round" if aside else "",
    ]
    return CandidatePose(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        distance_m=distance,
        roll_rad=bearing.roll_rad + roll,
        T_base_camera=T_base_camera,
        T_base_flange=T_base_camera @ inverse(view_target.T_flange_camera),
        fallback=", ".join(part for part in parts if part) or None,
    )
