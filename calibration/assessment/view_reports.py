"""What became of each view, and of one that was left out why, as a person would say it."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_poses, twist_from_pose
from calibration.observations import Mounting
from calibration.pose_estimation.board_pose import BoardPoses
from calibration.result import ViewReport
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.cross_validation import CrossValidation
from calibration.solver.pose_solution import Poses, PoseSolution
from calibration.solver.problem import Problem, robot_error
from calibration.target.board import FEWEST_CORNERS

FITS_M, FITS_RAD = 2e-3, np.radians(0.5)
"""A picture that is as near as this to what another explanation predicts is explained by it."""


def report_views(
    names: tuple[str, ...], problem: Problem, alone: BoardPoses, adjusted: Adjustment, left_out: CrossValidation
) -> tuple[ViewReport, ...]:
    """One for each view, in the order given."""
    used = adjusted.used
    squares = adjusted.linearised.squares
    counts = problem.corners.seen.sum(axis=1)
    errors = np.where(used[:, None], adjusted.unknowns.errors, left_out.errors)
    distances = distances_m(problem, alone)
    reports = []
    for k, name in enumerate(names):
        if used[k]:
            reason, rms = None, np.sqrt(squares[k] / (2 * adjusted.good[k].sum()))
        else:
            reason, rms = _reason(k, names, problem, alone, adjusted, left_out), left_out.rms_px[k]
        reports.append(
            ViewReport(
                name=name,
                used=bool(used[k]),
                reason=reason,
                corners=int(counts[k]),
                rms_px=_known(rms),
                robot_error_m=_known(np.linalg.norm(errors[k, 3:])),
                robot_error_rad=_known(np.linalg.norm(errors[k, :3])),
                left_out_m=_known(left_out.off_m[k]),
                distance_m=_known(distances[k]),
            )
        )
    return tuple(reports)


def pose_reports(names: tuple[str, ...], poses: Poses, solution: PoseSolution) -> tuple[ViewReport, ...]:
    """The same where there are poses only."""
    errors = np.where(solution.used[:, None], solution.errors, solution.left_out)
    reports = []
    for k, name in enumerate(names):
        reason = None
        if not solution.used[k]:
            flange, T = poses.T_base_flange, poses.T_camera_board[k]
            other = _explaining(k, poses.mounting, flange, solution.X, solution.Y, T, names)
            reason = other or _off_words(solution.left_out[k])
        reports.append(
            ViewReport(
                name=name,
                used=bool(solution.used[k]),
                reason=reason,
                corners=0,
                rms_px=None,
                robot_error_m=float(np.linalg.norm(errors[k, 3:])),
                robot_error_rad=float(np.linalg.norm(errors[k, :3])),
                left_out_m=float(solution.off_m[k]),
                distance_m=float(poses.distances_m[k]),
            )
        )
    return tuple(reports)


def distances_m(problem: Problem, alone: BoardPoses) -> NDArray[np.float64]:
    """(N,) from the camera to the board's middle; NaN where a view has no pose."""
    return np.linalg.norm((alone.T_camera_board @ np.append(problem.corners.middle, 1.0))[:, :3], axis=1)


def _known(value: float | np.floating) -> float | None:
    return float(value) if np.isfinite(value) else None


def _reason(
    k: int, names: tuple[str, ...], problem: Problem, alone: BoardPoses, adjusted: Adjustment, left_out: CrossValidation
) -> str:
    if not alone.found[k]:
        seen = int(problem.corners.seen[k].sum())
        if seen < FEWEST_CORNERS:
            return f"it shows {seen} corners, and {FEWEST_CORNERS} are needed: bring the whole board into the picture"
        return "its corners do not lie as on the board: check that it is this board, flat, sharp and not mirrored"
    T, X, Y = alone.T_camera_board[k], adjusted.unknowns.X, adjusted.unknowns.Y
    flange = problem.T_base_flange
    if _fits(problem.mounting, flange[k : k + 1], X, Y, T @ half_turn(problem.corners.middle))[0]:
        return "its board is turned by half a turn: it was moved, or numbered from the opposite corner"
    return _explaining(k, problem.mounting, flange, X, Y, T, names) or _off_words(left_out.errors[k])


def _explaining(k: int, mounting: Mounting, flange, X, Y, T_camera_board, names: tuple[str, ...]) -> str | None:
    """Whether another view's pose has to do with what is wrong with view `k`."""
    others = np.arange(len(names)) != k
    fitting = np.flatnonzero(_fits(mounting, flange, X, Y, T_camera_board) & others)
    if len(fitting):
        other = names[fitting[0]]
        return f"its picture fits the pose of view {other}: the two were swapped, or the pose was read at another time"
    apart = twist_from_pose(invert_poses(flange[k]) @ flange)
    same = (np.linalg.norm(apart[:, 3:], axis=1) < FITS_M) & (np.linalg.norm(apart[:, :3], axis=1) < FITS_RAD)
    if (same & others).any():
        other = names[int(np.argmax(same & others))]
        return (
            f"its pose is that of view {other}, but its picture is not: read the pose when the arm has arrived, with "
            "the picture"
        )
    return None


def _off_words(error: NDArray[np.float64]) -> str:
    off_m, off_rad = np.linalg.norm(error[3:]), np.linalg.norm(error[:3])
    return (
        f"the arm would have been {1e3 * off_m:.1f} mm and {np.degrees(off_rad):.2f} degrees from where it said: read "
        "the pose while the arm is at rest, and see that board and camera were not touched"
    )


def half_turn(middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of the board by 180 degrees in its plane about its `middle` (3,)."""
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    T[:2, 3] = 2 * middle[:2]
    return T


def _fits(mounting: Mounting, flange, X, Y, T_camera_board: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) by which flange poses (N, 4, 4) the board would be seen at `T_camera_board` (4, 4)."""
    v = twist_from_pose(robot_error(mounting, flange, X, Y, T_camera_board[None]))
    return (np.linalg.norm(v[:, 3:], axis=1) < FITS_M) & (np.linalg.norm(v[:, :3], axis=1) < FITS_RAD)
