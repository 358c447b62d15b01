"""Makes views of a board that looks the same from several sides begin to number it at the same corner."""

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

ENOUGH_RAD = 0.2
"""A difference larger than this speaks for another numbering no more than this does: one bad view must not decide."""
ROUNDS = 20


def make_numbering_consistent(observations: Observations, certain: Sequence[bool]) -> Observations:
    """The same views, renumbered so that they agree with one another; those that are `certain` (N,) stay as they are.

    Between two views the camera turned as far as the flange did (or, where the camera stands in the cell, the board
    did): of the numberings that the board allows those are taken that fit this best. Which corner is the first then is
    left to chance, unless a view is certain.
    """
    possible = symmetric_numberings(observations.board)
    if len(possible) == 1 or all(certain) or not observations.views:
        return observations
    found = estimate_board_poses(stack_corners(observations))
    usable = np.flatnonzero(found.found)
    if not len(usable):
        return observations
    fixed = np.array(certain)[usable]
    flange = np.array([observations.views[k].T_base_flange[:3, :3] for k in usable])
    if observations.mounting == "eye-to-hand":
        flange = flange.transpose(0, 2, 1)
    unlike = _unlike(flange, _turned(found.T_camera_board[usable, :3, :3], observations.board, possible))
    chosen = _agreeing(unlike, fixed)
    views = list(observations.views)
    for k, choice in zip(usable, chosen, strict=True):
        views[k] = replace(views[k], ids=possible[choice][views[k].ids])
    return replace(observations, views=tuple(views))


def number_nearest_prediction(observations: Observations, T_camera_board: NDArray[np.float64]) -> Observations:
    """The same views, each renumbered so that the board appears turned as little as possible from where it is taken to
    be, `T_camera_board` (N, 4, 4)."""
    possible = symmetric_numberings(observations.board)
    if len(possible) == 1 or not observations.views:
        return observations
    found = estimate_board_poses(stack_corners(observations))
    usable = np.flatnonzero(found.found)
    turned = _turned(found.T_camera_board[usable, :3, :3], observations.board, possible)
    off = rotation_angles(turned.swapaxes(2, 3) @ T_camera_board[usable, :3, :3])
    views = list(observations.views)
    for k, choice in zip(usable, off.argmin(axis=0), strict=True):
        views[k] = replace(views[k], ids=possible[choice][views[k].ids])
    return replace(observations, views=tuple(views))


def _turned(
    R_camera_board: NDArray[np.float64], board: Board, possible: list[NDArray[np.int64]]
) -> NDArray[np.float64]:
    """(P, N, 3, 3) how the board would be turned by each of the P numberings."""
    middle = board.points - board.points.mean(axis=0)
    turns = []
    for numbers in possible:
        # Renumbered, each corner stands for another point: the board is turned back by what carries one to the other.
        M = middle.T @ middle[numbers]
        M[2, 2] = 1.0  # it is flat, and stays so
        turns.append(R_camera_board @ nearest_rotation(M))
    return np.array(turns)


def _unlike(R_base_flange: NDArray[np.float64], R_camera_board: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, N, P, P) by how much the flange and the camera turned differently between two views, for their numberings."""
    of_flange = rotation_angles(np.einsum("iba,jbc->ijac", R_base_flange, R_base_flange))
    of_camera = rotation_angles(np.einsum("piab,qjcb->ijpqac", R_camera_board, R_camera_board))
    return np.minimum(np.abs(of_camera - of_flange[:, :, None, None]), ENOUGH_RAD)


def _agreeing(unlike: NDArray[np.float64], fixed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(N,) the numbering of each view with which all fit best: from the view of each in turn, then improved."""
    count = len(fixed)
    best, least = np.zeros(count, dtype=np.int64), np.inf
    every = np.arange(count)
    for reference in np.flatnonzero(fixed) if fixed.any() else every:
        chosen = np.where(fixed, 0, unlike[reference, :, 0].argmin(axis=1))
        for _ in range(ROUNDS):
            # For view j numbered q: against all others as they are numbered now.
            cost = unlike[every, :, chosen].sum(axis=0)
            improved = np.where(fixed, 0, cost.argmin(axis=1))
            if (improved == chosen).all():
                break
            chosen = improved
        total = float(unlike[every[:, None], every, chosen[:, None], chosen].sum())
        if total < least:
            best, least = chosen, total
    return best
