"""Camera poses of a hand-eye calibration, and the path through them.

The board lies flat on the table within `OFF_MIDDLE_M` of the workspace's middle, in any orientation.

Near poses with a large roll determine the camera's mounting best. Far poses separate it from the focal length and the
size of the board. Two of three poses are near, and one is far.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.target.board import Board
from cell.config.cell_config import CellSettings
from cell.config.strict_model import Range
from cell.errors import ViewpointsError
from cell.planning.candidate_poses import ViewTarget, candidate_levels
from cell.planning.look_at import Bearing
from cell.planning.viewpoints import ViewpointPlan, describe_missing, plan_through

POSES, HELD_OUT = 15, 2
"""Number of poses to solve from, and number of further poses for the verification."""
MIN_POSES = 10
"""Smallest number of reachable poses to solve from."""
OFF_MIDDLE_M = 0.03
"""Largest distance of the board's middle from the middle of the workspace."""
FOCUS_MARGIN_M = 0.25
"""Smallest distance from the board's middle, unless camera.working_m is smaller."""
MIN_RATIO, MAX_RATIO = 1.25, 1.75
"""Limits of the ratio between the far and the near distance. A larger ratio adds little and is hard to reach."""
MIN_OF_EACH = 3
"""Number of near poses and of far poses that determine the focal length and the board's size."""
UNVERIFIED = (
    "none of the verification poses can be reached, so the calibration will not be verified: change "
    "x_m or y_m in [workspace]"
)

_NEAR_ELEVATION_RAD, _FAR_ELEVATION_RAD, _HELD_ELEVATION_RAD = np.deg2rad((60.0, 70.0, 65.0))
_NEAR_ROLL_RAD, _FAR_ROLL_RAD, _HELD_ROLL_RAD = np.deg2rad((75.0, 25.0, 50.0))
_CIRCLE = 16
"""Number of points on the rim of the area in which the board may lie."""


@dataclass(frozen=True)
class _Direction:
    bearing: Bearing
    distance_m: float
    range_m: Range


@dataclass(frozen=True)
class _Distances:
    near_m: float
    far_m: float

    @property
    def middle_m(self) -> float:
        return (self.near_m + self.far_m) / 2

    @property
    def range_m(self) -> Range:
        return self.near_m, self.far_m


def plan_calibration(
    settings: CellSettings,
    board: Board,
    T_flange_camera: NDArray[np.float64],
    q_now_rad: ArrayLike | None,
    poses: int = POSES,
    held_out: int = HELD_OUT,
) -> ViewpointPlan:
    """Plan the poses of a calibration and the path through them. The same arguments give the same plan.

    If no pose for the verification is reachable, the last reachable pose to solve from is held out too. If there are
    too few of these, the plan has a warning.

    Args:
        settings: Settings of the cell.
        board: Board on the table.
        T_flange_camera: Camera pose on the flange (4, 4), accurate to a few centimetres and degrees.
        q_now_rad: Joint angles (6,) at the start. None means home.
        poses: Number of poses to solve from, which come first in the plan.
        held_out: Number of poses for the verification, which come last.

    Raises:
        ViewpointsError: Fewer than `MIN_POSES` (or `poses`) are reachable. The message names the others.
    """
    view_target = board_target(settings, board, T_flange_camera)
    distances = _distances(view_target)
    preferred = [*_solving_directions(distances, poses), *_held_out_directions(distances, poses, held_out)]
    plan = _plan(settings, view_target, preferred, q_now_rad)
    solved_from = [v for v in plan.viewpoints[:poses] if v.q_rad is not None]
    least = min(MIN_POSES, poses)
    if len(solved_from) < least:
        smaller = (
            f"take a smaller board, as the camera sees all of this one from {distances.near_m:.2f} m on only, or "
            if distances.near_m > view_target.optics.working_m[1]
            else ""
        )
        raise ViewpointsError(
            f"only {len(solved_from)} of {poses} calibration poses can be reached, {least} are needed: {smaller}change "
            f"x_m or y_m in [workspace] so that the arm reaches around its centre. Not reached are "
            f"{describe_missing(plan)}"
        )
    reached, warnings = tuple(range(poses, poses + held_out)), ()
    if reached and all(v.q_rad is None for v in plan.viewpoints[poses:]):
        if len(solved_from) > least:
            reached = (solved_from.pop().index, *reached)
        else:
            warnings = (UNVERIFIED,)
    return replace(
        plan, held_out=reached, warnings=warnings + _too_similar([v.distance_m for v in solved_from], distances)
    )


def plan_verification(
    settings: CellSettings, board: Board, T_flange_camera: NDArray[np.float64], q_now_rad: ArrayLike | None
) -> ViewpointPlan:
    """Plan two poses on opposite sides of the board, from which a wrong calibration shows the board at two positions.

    Args:
        settings: Settings of the cell.
        board: Board on the table.
        T_flange_camera: Camera pose on the flange (4, 4).
        q_now_rad: Joint angles (6,) at the start. None means home.

    Raises:
        ViewpointsError: One of the two poses is not reachable.
    """
    view_target = board_target(settings, board, T_flange_camera)
    distances = _distances(view_target)
    # beside the line from the arm to the board, because the far side may be out of reach
    across = float(np.arctan2(view_target.centre[1], view_target.centre[0])) + np.pi / 2
    preferred = [
        _Direction(Bearing(across, _NEAR_ELEVATION_RAD, _FAR_ROLL_RAD), distances.near_m, distances.range_m),
        _Direction(Bearing(across + np.pi, _NEAR_ELEVATION_RAD, -_FAR_ROLL_RAD), distances.near_m, distances.range_m),
    ]
    plan = _plan(settings, view_target, preferred, q_now_rad)
    if plan.reachable < len(preferred):
        raise ViewpointsError(
            "a calibration is verified from two sides of the board, and the arm does not reach both: change x_m or "
            f"y_m in [workspace]. Not reached are {describe_missing(plan)}"
        )
    return replace(plan, held_out=(0, 1))


def board_target(settings: CellSettings, board: Board, T_flange_camera: NDArray[np.float64]) -> ViewTarget:
    """Return the view target of a board near the middle of a cell's workspace."""
    optics = settings.camera.optics
    # the smallest distance for depth does not matter for images
    working_m = settings.camera.working_m or (min(FOCUS_MARGIN_M, optics.working_m[0]), optics.working_m[1])
    floor = ViewTarget.of(settings, replace(optics, near_m=0.0, working_m=working_m), T_flange_camera)
    # each corner of a ChArUco board is detected by itself; every other board must be in the image with its margin
    size = np.ptp(board.points, axis=0)[:2] if board.kind == "charuco" else np.array(board.size_m)
    radius = float(np.linalg.norm(size)) / 2 + OFF_MIDDLE_M
    angles = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(_CIRCLE)])
    return replace(floor, corners=rim)


def _distances(view_target: ViewTarget) -> _Distances:
    """Return the near distance, where the board fills the image, and the far one, up to the working range."""
    steepest = [Bearing(0.0, _NEAR_ELEVATION_RAD, roll) for roll in np.linspace(0.0, np.pi / 2, 7)]
    nearest, farthest = view_target.optics.working_m
    near = max(nearest, *(view_target.min_distance(bearing) for bearing in steepest))
    return _Distances(near, float(np.clip(farthest, MIN_RATIO * near, MAX_RATIO * near)))


def _solving_directions(distances: _Distances, poses: int) -> list[_Direction]:
    preferred = []
    for k in range(poses):
        if k % 3 == 2:
            elevation, roll, distance = _FAR_ELEVATION_RAD, (-1) ** k * _FAR_ROLL_RAD, distances.far_m
        else:
            elevation, roll, distance = _NEAR_ELEVATION_RAD, (-1) ** (k % 3) * _NEAR_ROLL_RAD, distances.near_m
        preferred.append(_Direction(Bearing(2 * np.pi * k / poses, elevation, roll), distance, distances.range_m))
    return preferred


def _held_out_directions(distances: _Distances, poses: int, held_out: int) -> list[_Direction]:
    """Return poses between the others in azimuth, elevation, roll and distance."""
    return [
        _Direction(
            Bearing(2 * np.pi * (k / held_out + 0.5 / poses), _HELD_ELEVATION_RAD, float((-1) ** k * _HELD_ROLL_RAD)),
            distances.middle_m,
            distances.range_m,
        )
        for k in range(held_out)
    ]


def _plan(
    settings: CellSettings, view_target: ViewTarget, preferred: Sequence[_Direction], q_now_rad: ArrayLike | None
) -> ViewpointPlan:
    poses = [candidate_levels(view_target, each.bearing, each.distance_m, each.range_m) for each in preferred]
    return plan_through(settings, view_target, poses, q_now_rad)


def _too_similar(reached_m: list[float], distances: _Distances) -> tuple[str, ...]:
    """Return a warning if too few of the reachable poses are near, or far."""
    far = sum(distance > distances.middle_m for distance in reached_m)
    near = len(reached_m) - far
    if min(near, far) >= MIN_OF_EACH:
        return ()
    return (
        f"of the calibration poses that can be reached {near} are near the board and {far} far from it: with fewer "
        f"than {MIN_OF_EACH} of each, an error of the board's size or of the focal length goes unnoticed. Change x_m "
        "or y_m in [workspace], or camera.working_m",
    )
