"""Find views that were taken at the same robot pose, and choose one of them for the solver.

The solver assumes that the robot errors of all views are independent, but views at one robot pose have the same error.
If all these views counted, the reported accuracy would be too optimistic.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import stack_corners
from calibration.result import ViewReport

SAME_POSE_M = 1e-3
"""Maximum distance between equal flange poses, metres: about ten times the repeatability of a robot."""
SAME_POSE_RAD = np.radians(0.2)
"""Maximum angle between equal flange poses, radians."""
SAME_BOARD_M = 0.01
"""Maximum distance between the board poses of duplicates, metres. A larger difference at one flange pose means that one
view is wrong. The solver excludes the wrong view later."""
SAME_BOARD_RAD = np.radians(3.0)
"""Maximum angle between the board poses of duplicates, radians."""


def group_equal_poses(T_base_flange: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the index (N,) of the first pose that equals each flange pose.

    Args:
        T_base_flange: (N, 4, 4) flange poses, metres. A pose without an earlier equal pose gets its own index.
    """
    groups = np.arange(len(T_base_flange))
    firsts: list[int] = []
    for k, pose in enumerate(T_base_flange):
        others = T_base_flange[firsts]
        distances = np.linalg.norm(others[:, :3, 3] - pose[:3, 3], axis=1)
        # The Frobenius norm |R1 - R2| is 2 sqrt(2) sin(angle / 2), about sqrt(2) times a small angle.
        angles = np.linalg.norm(others[:, :3, :3] - pose[:3, :3], axis=(1, 2)) / np.sqrt(2.0)
        equal = np.flatnonzero((distances < SAME_POSE_M) & (angles < SAME_POSE_RAD))
        if len(equal):
            groups[k] = firsts[equal[0]]
        else:
            firsts.append(k)
    return groups


def choose_representatives(observations: Observations) -> NDArray[np.int64]:
    """Return the index (N,) of the view that represents each of N views in the solver.

    Views with an equal flange pose and an equal board pose are represented by the view with the most corners. Every
    other view represents itself.
    """
    groups = group_equal_poses(observations.T_base_flange)
    chosen = np.arange(len(groups))
    repeated = np.flatnonzero(np.bincount(groups)[groups] > 1)
    if len(repeated):
        views = tuple(observations.views[k] for k in repeated)
        corners = stack_corners(replace(observations, views=views))
        order = np.argsort(-corners.seen.sum(axis=1), kind="stable")
        T_camera_board = estimate_board_poses(corners).T_camera_board
        chosen[repeated] = repeated[_representatives(groups[repeated], T_camera_board, corners.middle, order)]
    return chosen


def add_duplicate_reports(
    reports: tuple[ViewReport, ...], observations: Observations, representatives: NDArray[np.int64]
) -> tuple[ViewReport, ...]:
    """Return one report per view, in the given order, with reports for the duplicate views added.

    Args:
        reports: Reports on the views that went into the solver.
        observations: All N views.
        representatives: (N,) view indices from `choose_representatives`.
    """
    by_name = {report.name: report for report in reports}
    all_reports = []
    for view, chosen in zip(observations.views, representatives, strict=True):
        report = by_name[observations.views[chosen].name]
        if report.name != view.name:
            report = _report_duplicate(view, report)
        all_reports.append(report)
    return tuple(all_reports)


def _report_duplicate(view: BoardView, representative: ViewReport) -> ViewReport:
    return ViewReport(
        name=view.name,
        used=False,
        reason=f"the robot pose is the same as in view {representative.name}, and each pose counts once: move the "
        "robot between images",
        corners=len(view.ids),
        rms_px=None,
        robot_error_m=None,
        robot_error_rad=None,
        loo_error_m=None,
        distance_m=representative.distance_m,
    )


def _representatives(
    groups: NDArray[np.int64],
    T_camera_board: NDArray[np.float64],
    middle: NDArray[np.float64],
    order: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the index (N,) of the view that represents each view: the first duplicate in `order`.

    Args:
        groups: (N,) indices of equal flange poses, from `group_equal_poses`.
        T_camera_board: (N, 4, 4) board poses. A view with a NaN pose represents itself.
        middle: (3,) middle of the board, board frame, metres.
        order: (N,) view indices, the preferred views first.
    """
    middles = T_camera_board[:, :3, :3] @ middle + T_camera_board[:, :3, 3]
    rotations = T_camera_board[:, :3, :3]
    chosen = np.arange(len(groups))
    kept = np.zeros(len(groups), dtype=bool)
    for k in order:
        others = np.array([other for other in order if kept[other] and groups[other] == groups[k]], dtype=np.int64)
        equal = np.linalg.norm(middles[others] - middles[k], axis=1) < SAME_BOARD_M
        equal &= rotation_angles(rotations[others].swapaxes(1, 2) @ rotations[k]) < SAME_BOARD_RAD
        if equal.any():
            chosen[k] = others[np.flatnonzero(equal)[0]]
        else:
            kept[k] = True
    return chosen
