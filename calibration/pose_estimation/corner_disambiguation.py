"""Make views of a symmetric board agree on the first corner."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import nearest_rotation, rotation_angles
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import stack_corners
from calibration.target.board import Board
from calibration.target.corner_ordering import symmetric_numberings

MAX_DISAGREEMENT_RAD = 0.2
"""Larger disagreements between two views are counted as this, so that one bad view does not decide."""
MAX_ITERATIONS = 20
"""Maximum number of improvements of the numberings from one reference view."""


def make_numbering_consistent(observations: Observations, is_unique: Sequence[bool]) -> Observations:
    """Renumber the views of a symmetric board so that they agree with one another.

    Between two views the camera rotates by the same angle as the flange (or, for a camera in the cell, the board does).
    The numberings that fit this best are chosen. The first corner is arbitrary unless one view has a unique numbering.

    Args:
        observations: The board, the camera and the views.
        is_unique: (N,) whether the numbering of a view is unique. Such views keep their numbers.

    Returns:
        The same views with consistent numbers.
    """
    numberings = symmetric_numberings(observations.board)
    if len(numberings) == 1 or all(is_unique) or not observations.views:
        return observations
    poses = estimate_board_poses(stack_corners(observations))
    usable = np.flatnonzero(poses.found)
    if not len(usable):
        return observations
    fixed = np.array(is_unique)[usable]
    R_base_flange = np.array([observations.views[k].T_base_flange[:3, :3] for k in usable])
    if observations.mounting == "eye-to-hand":
        R_base_flange = R_base_flange.transpose(0, 2, 1)
    R_camera_board = _rotations_by_numbering(poses.T_camera_board[usable, :3, :3], observations.board, numberings)
    chosen = _choose_numberings(_rotation_disagreements(R_base_flange, R_camera_board), fixed)
    views = list(observations.views)
    for k, choice in zip(usable, chosen, strict=True):
        views[k] = replace(views[k], ids=numberings[choice][views[k].ids])
    return replace(observations, views=tuple(views))


def renumber_to_prediction(observations: Observations, T_camera_board: NDArray[np.float64]) -> Observations:
    """Renumber each view of a symmetric board so that the board pose is nearest to a prediction.

    Args:
        observations: The board, the camera and the views.
        T_camera_board: (N, 4, 4) predicted board poses, of which only the rotations are used.

    Returns:
        The same views with new numbers.
    """
    numberings = symmetric_numberings(observations.board)
    if len(numberings) == 1 or not observations.views:
        return observations
    poses = estimate_board_poses(stack_corners(observations))
    usable = np.flatnonzero(poses.found)
    rotations = _rotations_by_numbering(poses.T_camera_board[usable, :3, :3], observations.board, numberings)
    angles = rotation_angles(rotations.swapaxes(2, 3) @ T_camera_board[usable, :3, :3])
    views = list(observations.views)
    for k, choice in zip(usable, angles.argmin(axis=0), strict=True):
        views[k] = replace(views[k], ids=numberings[choice][views[k].ids])
    return replace(observations, views=tuple(views))


def _rotations_by_numbering(
    R_camera_board: NDArray[np.float64], board: Board, numberings: list[NDArray[np.int64]]
) -> NDArray[np.float64]:
    """Return the board rotations (P, N, 3, 3) of N views with each of P numberings."""
    centred = board.points - board.points.mean(axis=0)
    rotations = []
    for numbers in numberings:
        # With another numbering each corner stands for another point, so the board is rotated by the inverse map.
        M = centred.T @ centred[numbers]
        M[2, 2] = 1.0  # The board is flat, so M has no third direction.
        rotations.append(R_camera_board @ nearest_rotation(M))
    return np.array(rotations)


def _rotation_disagreements(
    R_base_flange: NDArray[np.float64], R_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the difference (N, N, P, P) of the flange's and the camera's rotation angle between two views, radians."""
    flange_angles = rotation_angles(np.einsum("iba,jbc->ijac", R_base_flange, R_base_flange))
    camera_angles = rotation_angles(np.einsum("piab,qjcb->ijpqac", R_camera_board, R_camera_board))
    return np.minimum(np.abs(camera_angles - flange_angles[:, :, None, None]), MAX_DISAGREEMENT_RAD)


def _choose_numberings(disagreements: NDArray[np.float64], fixed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the numbering (N,) of each view with the smallest total disagreement, improved from each reference."""
    count = len(fixed)
    best, smallest = np.zeros(count, dtype=np.int64), np.inf
    every = np.arange(count)
    for reference in np.flatnonzero(fixed) if fixed.any() else every:
        chosen = np.where(fixed, 0, disagreements[reference, :, 0].argmin(axis=1))
        for _ in range(MAX_ITERATIONS):
            # (N, P) disagreement of view j with numbering q with all other views as they are numbered now.
            sums = disagreements[every, :, chosen].sum(axis=0)
            improved = np.where(fixed, 0, sums.argmin(axis=1))
            if (improved == chosen).all():
                break
            chosen = improved
        total = float(disagreements[every[:, None], every, chosen[:, None], chosen].sum())
        if total < smallest:
            best, smallest = chosen, total
    return best
