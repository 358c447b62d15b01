"""Each view as predicted by the others: what would be solved without it, and how far off it is then.

Near the solution everything is linear, so that the solution without view i is one step away: its reduced normal
equations are taken off the sum. No view is solved for anew.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_stack, pose_from_twist, twist_from_pose
from calibration.observations import Mounting
from calibration.pose_estimation.board_pose import AHEAD, BoardPoses, refine_poses
from calibration.pose_estimation.projection import pixel_blocks
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.problem import Problem, board_motion_jacobian, robot_error
from calibration.solver.variance_components import robot_spread


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Of N views, used or not; NaN where a view has no board pose by itself."""

    errors: NDArray[np.float64]
    """(N, 6) where the robot was by this view's picture and the other views' calibration, in the told flange frame."""
    squares: NDArray[np.float64]
    """(N,) the same in standard deviations, squared: of everything, by the other views too. About 6 for a good view."""
    off_m: NDArray[np.float64]
    """(N,) distance of the board's middle from where the others see it."""
    rms_px: NDArray[np.float64]
    """(N,) reprojection error of the view's own best pose."""


def cross_validate(problem: Problem, alone: BoardPoses, adjusted: Adjustment) -> CrossValidation:
    """Every view (N) against the calibration by the other views that were used."""
    unknowns, mounting = adjusted.unknowns, problem.mounting
    step, covariance = _without_each(adjusted)
    X, Y = unknowns.X @ pose_from_twist(step[:, :6]), unknowns.Y @ pose_from_twist(step[:, 6:12])

    good = np.where(adjusted.used[:, None], adjusted.good, alone.good)
    T = np.where(alone.found[:, None, None], alone.T_camera_board, AHEAD)
    T = refine_poses(T, unknowns.lens, problem.corners, good)
    blocks = pixel_blocks(T, unknowns.lens, problem.corners, good)
    inner = blocks.information[:, :6, :6] + 1e-6 * np.eye(6)
    by_lens = -np.linalg.solve(inner, blocks.information[:, :6, 6:])
    T_camera_board = pose_from_twist((by_lens @ step[:, 12:, None])[..., 0]) @ T
    errors = twist_from_pose(robot_error(mounting, problem.T_base_flange, X, Y, T_camera_board))

    # What the errors are expected to be: the robot's noise, this view's corners' and the other views' uncertainty.
    back = invert_stack(board_motion_jacobian(mounting, unknowns.X, unknowns.Y, T))
    eye = np.broadcast_to(np.eye(6), (len(T), 6, 6))
    by_shared = back @ np.concatenate([eye, -adjoint(T), by_lens], axis=2)
    expected = (
        np.repeat(_robot_without_each(problem, adjusted) ** 2, 3, axis=1)[..., None] * np.eye(6)
        + adjusted.noise.pixel_px**2 * back @ invert_stack(inner) @ back.swapaxes(1, 2)
        + by_shared @ covariance @ by_shared.swapaxes(1, 2)
    )
    squares = (errors[:, None] @ np.linalg.solve(expected, errors[..., None]))[:, 0, 0]
    middle = np.append(adjusted.board_scale * problem.corners.middle, 1.0)
    off = np.linalg.norm(board_discrepancy(mounting, problem.T_base_flange, X, Y, T_camera_board) @ middle, axis=1)
    rms = np.sqrt(blocks.squares / np.maximum(2 * good.sum(axis=1), 1))
    known = [np.where(alone.found, values, np.nan) for values in (squares, off, rms)]
    return CrossValidation(np.where(alone.found[:, None], errors, np.nan), *known)


def board_discrepancy(
    mounting: Mounting,
    T_base_flange: NDArray[np.float64],
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(N, 4, 4) that, times a point of the board, is how far apart the camera and the calibration see it."""
    if mounting == "eye-in-hand":
        return T_base_flange @ X @ T_camera_board - Y
    return X @ T_camera_board - T_base_flange @ Y


def _without_each(adjusted: Adjustment) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, SHARED) the step to the solution without the view, and (N, SHARED, SHARED) that solution's covariance."""
    system, used = adjusted.linearised, adjusted.used
    own_share = np.where(used[:, None, None], system.reduced, 0.0)
    own_pull = np.where(used[:, None], system.reduced_pull, 0.0)
    others = system.shared_information(used) - own_share
    # Where the others alone determine nothing, as with three views, some number is better than none.
    diagonal = np.einsum("nii->ni", others)
    diagonal += 1e-12 * np.abs(diagonal)
    covariance = invert_stack(others)
    pull = own_pull.sum(axis=0) + system.prior_pull - own_pull
    return (covariance @ pull[..., None])[..., 0], covariance


def _robot_without_each(problem: Problem, adjusted: Adjustment) -> NDArray[np.float64]:
    """(N, 2) the robot's noise, rad and m, by the other views: a bad view must not excuse itself."""
    used = adjusted.used
    spread = robot_spread(
        adjusted.unknowns.errors, adjusted.noise, adjusted.linearised, adjusted.shared_covariance, used
    )
    return np.array([spread.sigmas(problem.assumed, k if used[k] else None) for k in range(len(used))])
