"""Leave-one-out cross-validation: compare each view with its prediction from the other views.

The problem is nearly linear at the solution. One linear step therefore gives the solution without a view: the reduced
normal equations of the view are subtracted from the sum over the views. The adjustment is not repeated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_stack, pose_from_twist, twist_from_pose
from calibration.observations import Mounting
from calibration.pose_estimation.board_pose import PLACEHOLDER_POSE, BoardPoses, refine_poses
from calibration.pose_estimation.projection import pixel_normal_equations
from calibration.solver.adjustment import Adjustment
from calibration.solver.problem import (
    BOARD_REGULARISATION,
    N_SHARED,
    Problem,
    board_motion_jacobian,
    implied_robot_errors,
)
from calibration.solver.variance_components import robot_error_squares

RELATIVE_DAMPING = 1e-12
"""Damping of the solution without a view, relative to the diagonal of its information matrix."""


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Leave-one-out errors of N views, including excluded views; NaN if no board pose was found in the view."""

    robot_errors: NDArray[np.float64]
    """(N, 6) robot error of each view, rotation (rad), then translation (m), in the frame of the reported flange pose.
    The error follows from the image of the view and from the calibration by the other views."""
    squares: NDArray[np.float64]
    """(N,) squared Mahalanobis length of `robot_errors`, about 6 for a good view. The covariance includes the
    uncertainty of the calibration from the other views."""
    loo_error_m: NDArray[np.float64]
    """(N,) distance between the observed middle of the board and its prediction from the other views, metres."""
    rms_px: NDArray[np.float64]
    """(N,) root mean square reprojection residual per image coordinate, pixels, with the board pose fitted to the view
    alone."""


def cross_validate(problem: Problem, board_poses: BoardPoses, adjusted: Adjustment) -> CrossValidation:
    """Compare each view with its prediction from the other used views.

    Args:
        problem: The measurements and priors.
        board_poses: Board poses, each estimated from one view alone.
        adjusted: The solution from the used views.
    """
    mounting = problem.mounting
    unknowns = adjusted.unknowns
    step, covariance = _leave_one_out_steps(adjusted)
    X = unknowns.X @ pose_from_twist(step[:, :6])
    Y = unknowns.Y @ pose_from_twist(step[:, 6:12])

    inliers = np.where(adjusted.used[:, None], adjusted.inliers, board_poses.inliers)
    T = np.where(board_poses.found[:, None, None], board_poses.T_camera_board, PLACEHOLDER_POSE)
    T = refine_poses(T, unknowns.corrections, problem.corners, inliers)
    blocks = pixel_normal_equations(T, unknowns.corrections, problem.corners, inliers)
    H_board = blocks.H[:, :6, :6] + BOARD_REGULARISATION * np.eye(6)
    J_corrections = -np.linalg.solve(H_board, blocks.H[:, :6, 6:])
    T_camera_board = pose_from_twist(np.matvec(J_corrections, step[:, 12:N_SHARED])) @ T
    robot_errors = twist_from_pose(implied_robot_errors(mounting, problem.T_base_flange, X, Y, T_camera_board))

    # Expected covariance of the errors: robot noise, corner noise of the view, and uncertainty of the prediction.
    J_board = invert_stack(board_motion_jacobian(mounting, unknowns.X, unknowns.Y, T))
    eye = np.broadcast_to(np.eye(6), (len(T), 6, 6))
    J_camera_board = np.concatenate([eye, -adjoint(T), J_corrections], axis=2)
    J_shared = np.concatenate([J_board @ J_camera_board, -problem.smooth_modes], axis=2)
    robot_variances = np.repeat(_leave_one_out_robot_sigmas(problem, adjusted) ** 2, 3, axis=1)
    expected = (
        robot_variances[..., None] * np.eye(6)
        + adjusted.noise.pixel_px**2 * J_board @ invert_stack(H_board) @ J_board.swapaxes(1, 2)
        + J_shared @ covariance @ J_shared.swapaxes(1, 2)
    )
    smooth_errors = np.vecdot(problem.smooth_modes, (unknowns.smooth_weights + step[:, N_SHARED:])[:, None])
    differences = robot_errors - smooth_errors
    squares = (differences[:, None] @ np.linalg.solve(expected, differences[..., None]))[:, 0, 0]
    middle = np.append(adjusted.board_scale * problem.corners.middle, 1.0)
    difference = _board_difference(mounting, problem.T_base_flange, X, Y, T_camera_board)
    loo_error_m = np.linalg.norm(difference @ middle, axis=1)
    rms = np.sqrt(blocks.squares_px2 / np.maximum(2 * inliers.sum(axis=1), 1))
    found = board_poses.found
    return CrossValidation(
        robot_errors=np.where(found[:, None], robot_errors, np.nan),
        squares=np.where(found, squares, np.nan),
        loo_error_m=np.where(found, loo_error_m, np.nan),
        rms_px=np.where(found, rms, np.nan),
    )


def _board_difference(
    mounting: Mounting,
    T_base_flange: NDArray[np.float64],
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return observed minus predicted board poses (N, 4, 4), base frame, metres.

    The product of such a difference and a homogeneous board point is the position error of the point.
    """
    if mounting == "eye-in-hand":
        return T_base_flange @ X @ T_camera_board - Y
    return X @ T_camera_board - T_base_flange @ Y


def _leave_one_out_steps(adjusted: Adjustment) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the change of the shared unknowns if one view is excluded, for each of the N views.

    Returns:
        Changes (N, N_SHARED), and covariances (N, N_SHARED, N_SHARED) of the unknowns without the view.
    """
    equations = adjusted.normal_equations
    used = adjusted.used
    own_H = np.where(used[:, None, None], equations.H_reduced, 0.0)
    own_g = np.where(used[:, None], equations.g_reduced, 0.0)
    H = equations.shared_information(used) - own_H
    # Damping keeps H invertible if the remaining views are too few for a solution, for example two of three.
    diagonal = np.einsum("nii->ni", H)
    diagonal += RELATIVE_DAMPING * np.abs(diagonal)
    covariance = invert_stack(H)
    g = own_g.sum(axis=0) + equations.g_prior - own_g
    return np.matvec(covariance, g), covariance


def _leave_one_out_robot_sigmas(problem: Problem, adjusted: Adjustment) -> NDArray[np.float64]:
    """Return robot sigmas (N, 2), rad and m, from the other views: a bad view must not raise its own error limit."""
    robot = robot_error_squares(adjusted)
    return np.array([robot.sigmas(problem.priors, excluded=k) for k in range(len(adjusted.used))])
