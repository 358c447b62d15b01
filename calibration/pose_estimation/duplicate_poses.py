"""Several pictures from one pose of the arm: they share its error, and only one of them is solved from.

Each view's robot error is taken to be its own. Pictures that share one would be counted as if the arm had gone there
anew each time, and the result would look surer than it is.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import stack_corners
from calibration.result import ViewReport

SAME_PLACE_M = 1e-3
"""Flange poses closer than this and than `SAME_DIRECTION_RAD` are one: ten times an arm's repeatability."""
SAME_DIRECTION_RAD = np.radians(0.2)
ALIKE_M, ALIKE_RAD = 0.01, np.radians(3.0)
"""From one pose, pictures that put the board closer together than this show the same, all but for noise; others show
that a pose was not read with its picture, which is found out later."""


def number_poses(T_base_flange: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) which of the different poses each of the poses (N, 4, 4) is: the number of the first view of it."""
    numbers = np.arange(len(T_base_flange))
    first: list[int] = []
    for k, pose in enumerate(T_base_flange):
        others = T_base_flange[first]
        apart = np.linalg.norm(others[:, :3, 3] - pose[:3, 3], axis=1)
        # |R1 - R2| is 2 sqrt(2) sin(angle / 2).
        turned = np.linalg.norm(others[:, :3, :3] - pose[:3, :3], axis=(1, 2)) / np.sqrt(2.0)
        same = np.flatnonzero((apart < SAME_PLACE_M) & (turned < SAME_DIRECTION_RAD))
        if len(same):
            numbers[k] = first[same[0]]
        else:
            first.append(k)
    return numbers


def find_duplicates(observations: Observations) -> NDArray[np.int64]:
    """(N,) the view that is solved from in each view's place: of pictures from one pose that with the most corners,
    else the view itself."""
    numbers = number_poses(np.array([view.T_base_flange for view in observations.views], dtype=np.float64))
    chosen = np.arange(len(numbers))
    repeated = np.flatnonzero(np.bincount(numbers)[numbers] > 1)
    if len(repeated):
        views = tuple(observations.views[k] for k in repeated)
        corners = stack_corners(replace(observations, views=views))
        order = np.argsort(-corners.seen.sum(axis=1), kind="stable")
        alone = estimate_board_poses(corners).T_camera_board
        chosen[repeated] = repeated[_first_alike(numbers[repeated], alone, corners.middle, order)]
    return chosen


def stand_ins_of_poses(T_base_flange: NDArray[np.float64], T_camera_board: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) the same of poses (N, 4, 4) alone: of those from one pose the first."""
    numbers = number_poses(T_base_flange)
    return _first_alike(numbers, T_camera_board, np.zeros(3), np.arange(len(numbers)))


def add_duplicate_reports(
    reports: tuple[ViewReport, ...],
    names: tuple[str, ...],
    chosen: NDArray[np.int64],
    corners: tuple[int, ...],
) -> tuple[ViewReport, ...]:
    """The reports of all views called `names` (N,) with so many `corners` (N,), from those of the views solved from."""
    by_name = {report.name: report for report in reports}
    return tuple(
        by_name[name] if k == chosen[k] else _repeated(name, corners[k], by_name[names[chosen[k]]])
        for k, name in enumerate(names)
    )


def _repeated(name: str, corners: int, stand_in: ViewReport) -> ViewReport:
    return ViewReport(
        name=name,
        used=False,
        reason=f"the arm stood as in view {stand_in.name}, and a pose counts once: move the arm between pictures",
        corners=corners,
        rms_px=None,
        robot_error_m=None,
        robot_error_rad=None,
        left_out_m=None,
        distance_m=stand_in.distance_m,
    )


def _first_alike(
    numbers: NDArray[np.int64],
    T_camera_board: NDArray[np.float64],
    middle: NDArray[np.float64],
    order: NDArray[np.int64],
) -> NDArray[np.int64]:
    """(N,) of each view the first by `order` that was taken from the same pose and shows the board at the same place;
    one without a board pose (NaN) is like no other."""
    middles = T_camera_board[:, :3, :3] @ middle + T_camera_board[:, :3, 3]
    rotations = T_camera_board[:, :3, :3]
    chosen = np.arange(len(numbers))
    kept = np.zeros(len(numbers), dtype=bool)
    for k in order:
        others = np.array([other for other in order if kept[other] and numbers[other] == numbers[k]], dtype=np.int64)
        near = np.linalg.norm(middles[others] - middles[k], axis=1) < ALIKE_M
        near &= rotation_angles(rotations[others].swapaxes(1, 2) @ rotations[k]) < ALIKE_RAD
        if near.any():
            chosen[k] = others[np.flatnonzero(near)[0]]
        else:
            kept[k] = True
    return chosen
