"""Make the corner numbers of a symmetric board consistent across views."""

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
"""Upper limit of the disagreement between two views, radians. It limits the influence of a bad view."""
MAX_ITERATIONS = 20
"""Maximum number of improvements of the numberings per reference view."""


def make_numbering_consistent(observations: Observations, is_unique: Sequence[bool]) -> Observations:
    """Renumber the corners of a symmetric board consistently in all views.

    Between two views, the board rotates in the camera frame by the same angle as the flange in the base frame. The
    function chooses the numberings that fit this rule best. If no view has a unique numbering, the first corner is
    arbitrary.

    Args:
        observations: The board, the camera and N views.
        is_unique: (N,) True for views with a unique numbering, which is kept.

    Returns:
        The observations with consistent corner numbers.
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
    """Renumber the corners of a symmetric board so that the board rotation in each view is nearest to a prediction.

    Args:
        observations: The board, the camera and N views.
        T_camera_board: (N, 4, 4) predicted board poses in the camera frame. Only the rotations are used.

    Returns:
        The observations with new corner numbers.
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
    """Return the board rotations (P, N, 3, 3) of N views under each of P numberings.

    Args:
        R_camera_board: (N, 3, 3) board rotations under the current numbering.
        board: The board.
        numberings: P permutations from `symmetric_numberings`.
    """
    centred = board.points - board.points.mean(axis=0)
    rotations = []
    for numbers in numberings:
        # Corner k gets the number numbers[k]. The board frame rotates by the map from point numbers[k] to point k.
        M = centred.T @ centred[numbers]
        M[2, 2] = 1.0  # The board is flat, so M has rank 2 without this entry.
        rotations.append(R_camera_board @ nearest_rotation(M))
    return np.array(rotations)


def _rotation_disagreements(
    R_base_flange: NDArray[np.float64], R_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the differences (N, N, P, P) between the rotation angles of flange and board for all view pairs, radians.

    Entry [i, j, p, q] is for view i with numbering p and view j with numbering q.

    Args:
        R_base_flange: (N, 3, 3) flange rotations; the inverse rotations for eye-to-hand.
        R_camera_board: (P, N, 3, 3) board rotations under each of P numberings.
    """
    flange_angles = rotation_angles(np.einsum("iba,jbc->ijac", R_base_flange, R_base_flange))
    camera_angles = rotation_angles(np.einsum("piab,qjcb->ijpqac", R_camera_board, R_camera_board))
    return np.minimum(np.abs(camera_angles - flange_angles[:, :, None, None]), MAX_DISAGREEMENT_RAD)


def _choose_numberings(disagreements: NDArray[np.float64], fixed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices (N,) of the numberings with the smallest total disagreement.

    The numberings are initialised from each reference view in turn and improved iteratively.

    Args:
        disagreements: (N, N, P, P) from `_rotation_disagreements`, radians.
        fixed: (N,) mask, True for views that keep numbering 0.
    """
    every = np.arange(len(fixed))
    references = np.flatnonzero(fixed) if fixed.any() else every
    candidates = [_fit_numberings(disagreements, fixed, reference) for reference in references.tolist()]
    totals = [disagreements[every[:, None], every, chosen[:, None], chosen].sum() for chosen in candidates]
    return candidates[int(np.argmin(totals))]


def _fit_numberings(disagreements: NDArray[np.float64], fixed: NDArray[np.bool_], reference: int) -> NDArray[np.int64]:
    """Return the numberings (N,) that fit the view `reference` with numbering 0, then improve them iteratively."""
    every = np.arange(len(fixed))
    chosen = np.where(fixed, 0, disagreements[reference, :, 0].argmin(axis=1))
    for _ in range(MAX_ITERATIONS):
        # sums[j, q] is the disagreement of view j, with numbering q, with all views under the current numberings.
        sums = disagreements[every, :, chosen].sum(axis=0)
        improved = np.where(fixed, 0, sums.argmin(axis=1))
        if (improved == chosen).all():
            break
        chosen = improved
    return chosen
