"""Reports on the views of a calibration, with the reason for each excluded view."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_poses, twist_from_pose
from calibration.pose_estimation.board_pose import BoardPoses
from calibration.result import ViewReport
from calibration.solver.outlier_rejection import ConsistentSolution
from calibration.solver.problem import Problem, Unknowns, implied_robot_errors
from calibration.target.board import MIN_CORNERS

MAX_MATCH_M = 2e-3
"""Maximum distance between two poses for an explanation to fit, metres."""
MAX_MATCH_RAD = np.radians(0.5)
"""Maximum rotation between two poses for an explanation to fit, radians."""


def report_views(
    names: tuple[str, ...],
    problem: Problem,
    board_poses: BoardPoses,
    solution: ConsistentSolution,
) -> tuple[ViewReport, ...]:
    """Return one report for each view, in the given order.

    Args:
        names: Names of the N views.
        problem: Measurements and priors of the calibration.
        board_poses: Board poses, each estimated from one view alone.
        solution: Solution of the calibration, with its cross-validation.
    """
    adjusted = solution.adjusted
    cross_validation = solution.cross_validation
    used = adjusted.used
    squares = adjusted.normal_equations.squares_px2
    counts = problem.corners.seen.sum(axis=1)
    errors = np.where(used[:, None], adjusted.unknowns.all_robot_errors(problem), cross_validation.robot_errors)
    distances = distances_m(problem, board_poses)
    reports = []
    for k, name in enumerate(names):
        if used[k]:
            reason = None
            rms = np.sqrt(squares[k] / (2 * adjusted.inliers[k].sum()))
        else:
            reason = _reason(k, names, problem, board_poses, solution)
            rms = cross_validation.rms_px[k]
        reports.append(
            ViewReport(
                name=name,
                used=bool(used[k]),
                reason=reason,
                corners=int(counts[k]),
                rms_px=_known(rms),
                robot_error_m=_known(np.linalg.norm(errors[k, 3:])),
                robot_error_rad=_known(np.linalg.norm(errors[k, :3])),
                loo_error_m=_known(cross_validation.loo_error_m[k]),
                distance_m=_known(distances[k]),
            )
        )
    return tuple(reports)


def distances_m(problem: Problem, board_poses: BoardPoses) -> NDArray[np.float64]:
    """Return the distances (N,) from the camera to the middle of the board, metres; NaN without a board pose.

    Args:
        problem: Measurements of the calibration, N views.
        board_poses: Board poses, each estimated from one view alone.
    """
    return np.linalg.norm((board_poses.T_camera_board @ np.append(problem.corners.middle, 1.0))[:, :3], axis=1)


def _known(value: float | np.floating) -> float | None:
    """Return the value as a float, or None for NaN and infinity."""
    return float(value) if np.isfinite(value) else None


def _reason(
    k: int, names: tuple[str, ...], problem: Problem, board_poses: BoardPoses, solution: ConsistentSolution
) -> str:
    """Return a message that says why view `k` was excluded and what to do."""
    if not board_poses.found[k]:
        seen = int(problem.corners.seen[k].sum())
        if seen < MIN_CORNERS:
            return f"it shows {seen} corners, and {MIN_CORNERS} are needed: bring the whole board into the image"
        return "its corners do not fit the board: check that it is the given board, flat, sharp and not mirrored"
    unknowns = solution.adjusted.unknowns
    T_camera_board = board_poses.T_camera_board[k]
    if _fitting_poses(problem, unknowns, T_camera_board @ _half_turn(problem.corners.middle))[k]:
        return "its board is turned by half a turn: it was moved, or numbered from the opposite corner"
    is_other = np.arange(len(names)) != k
    fitting = np.flatnonzero(_fitting_poses(problem, unknowns, T_camera_board) & is_other)
    if len(fitting):
        other = names[fitting[0]]
        return f"its image fits the pose of view {other}: the two were swapped, or the pose was read at another time"
    same = np.flatnonzero(_are_small(invert_poses(problem.T_base_flange[k]) @ problem.T_base_flange) & is_other)
    if len(same):
        other = names[same[0]]
        return (
            f"its pose is that of view {other}, but its image is not: read the pose together with the image, when the "
            "arm has arrived"
        )
    return _describe_robot_error(solution.cross_validation.robot_errors[k])


def _describe_robot_error(error: NDArray[np.float64]) -> str:
    """Return the message with the robot error (6,) that would explain the view: rotation (rad), translation (m)."""
    error_m = np.linalg.norm(error[3:])
    error_rad = np.linalg.norm(error[:3])
    return (
        f"the arm would have been {1e3 * error_m:.1f} mm and {np.degrees(error_rad):.2f} degrees from its reported "
        "pose: read the pose while the arm is at rest, and check that board and camera were not touched"
    )


def _half_turn(middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (4, 4) by 180 degrees about the board normal through the `middle` (3,) of the board."""
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    T[:2, 3] = 2 * middle[:2]
    return T


def _fitting_poses(problem: Problem, unknowns: Unknowns, T_camera_board: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (N,), True for the reported flange poses that explain the board pose `T_camera_board` (4, 4)."""
    errors = implied_robot_errors(problem.mounting, problem.T_base_flange, unknowns.X, unknowns.Y, T_camera_board)
    return _are_small(errors)


def _are_small(differences: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (N,), True for the pose differences (N, 4, 4) within `MAX_MATCH_M` and `MAX_MATCH_RAD`."""
    v = twist_from_pose(differences)
    return (np.linalg.norm(v[:, 3:], axis=1) < MAX_MATCH_M) & (np.linalg.norm(v[:, :3], axis=1) < MAX_MATCH_RAD)
