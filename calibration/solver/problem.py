"""Unknowns and normal equations of the bundle adjustment.

The controller reports the flange pose A_i of view i. The true flange pose is A_i E_i with a small robot error E_i. The
board pose in the camera frame is

    C_i = X^-1 (A_i E_i)^-1 Y    eye-in-hand: camera on the flange
    C_i = X^-1 (A_i E_i) Y       eye-to-hand: camera in the cell

All twists have the order rotation (rad), then translation (m). The twists x, y and e_i multiply X, Y and E_i from the
right. To first order, they change C_i by a twist c_i that multiplies C_i from the left:

    c_i = -x + adjoint(C_i) y + J_i e_i    J_i from `board_motion_jacobian`

In the normal equations `H @ step = g`, H is the information matrix J^T W J, and g is the right-hand side J^T W r. The
robot errors are eliminated view by view (Schur complement of 6x6 blocks).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, invert_stack, pose_from_twist, right_jacobian, solve_stack
from calibration.observations import Mounting
from calibration.pose_estimation.projection import N_CORRECTIONS, Corners, PixelNormalEquations, pixel_normal_equations
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.smooth_errors import smooth_modes

N_SHARED = 12 + N_CORRECTIONS
"""Number of unknowns shared by all views, in this order: twist of X (6), twist of Y (6), and the `N_CORRECTIONS`
corrections of the camera matrix and the board scale. A twist has the order rotation (rad), then translation (m)."""
BOARD_REGULARISATION = 1e-6
"""Information that is added about the board pose of each view. It matters for views without corners only."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Measurements and priors of a calibration, including the views that the solution excludes."""

    corners: Corners
    """Measured corners of N views of a board with M points."""
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4) flange poses reported by the robot, base frame, metres."""
    mounting: Mounting
    """Whether the camera is on the flange or in the cell."""
    priors: NoisePriors
    """Prior standard deviations of the noise, the lens and the board scale."""

    has_smooth_errors: bool = False
    """Whether a part of the robot errors changes smoothly with the flange pose (see `smooth_errors`)."""
    lens_weight: float = 1.0
    """Weight of the information about the lens that a view adds to the pose of its board, from 0 to 1. It is below 1 if
    neighbouring corners have similar errors (see `corner_patterns`)."""

    @cached_property
    def smooth_modes(self) -> NDArray[np.float64]:
        """(N, 6, S) Jacobian of the robot errors with respect to the smooth weights. S is 0 without smooth errors."""
        modes = smooth_modes(self.T_base_flange)
        return modes if self.has_smooth_errors else modes[:, :, :0]

    @property
    def correction_sigmas(self) -> NDArray[np.float64]:
        """(N_CORRECTIONS,) prior standard deviations of the lens parameters and of the logarithm of the board scale."""
        return np.array([self.priors.focal] * 2 + [self.priors.centre] * 2 + [self.priors.scale])


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values of all unknowns of the bundle adjustment."""

    X: NDArray[np.float64]
    """(4, 4) camera pose, as `HandEyeResult.X`."""
    Y: NDArray[np.float64]
    """(4, 4) board pose, as `HandEyeResult.Y`."""
    robot_errors: NDArray[np.float64]
    """(N, 6) robot error of each view: rotation (rad), then translation (m). The true flange pose is
    `T_base_flange @ pose_from_twist(robot_error)`."""
    corrections: NDArray[np.float64]
    """(N_CORRECTIONS,) corrections of the camera matrix and of the board scale (see `projection.N_CORRECTIONS`)."""
    smooth_weights: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """(S,) weights of the smooth robot errors (see `smooth_errors.smooth_modes`)."""

    def all_robot_errors(self, problem: Problem) -> NDArray[np.float64]:
        """Return the sums (N, 6) of the robot error of each view and its smooth robot error."""
        return self.robot_errors + problem.smooth_modes @ self.smooth_weights

    def T_camera_board(self, problem: Problem) -> NDArray[np.float64]:
        """Return the predicted board poses (N, 4, 4) in the camera frame, metres."""
        T_base_flange = problem.T_base_flange @ pose_from_twist(self.all_robot_errors(problem))
        if problem.mounting == "eye-in-hand":
            return invert_poses(self.X) @ invert_poses(T_base_flange) @ self.Y
        return invert_poses(self.X) @ T_base_flange @ self.Y

    def add_step(self, shared: NDArray[np.float64], robot_errors: NDArray[np.float64]) -> "Unknowns":
        """Return the unknowns after the steps `shared` (N_SHARED,) and `robot_errors` (N, 6)."""
        return Unknowns(
            X=self.X @ pose_from_twist(shared[:6]),
            Y=self.Y @ pose_from_twist(shared[6:12]),
            robot_errors=self.robot_errors + robot_errors,
            corrections=self.corrections + shared[12:N_SHARED],
            smooth_weights=self.smooth_weights + shared[N_SHARED:],
        )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations linearised at the current unknowns, weighted by the inverse noise variances.

    All N views have blocks, including unused views. The cost and the sums over views exclude unused views.
    """

    H_robot: NDArray[np.float64]
    """(N, 6, 6) information matrix of the robot error of each view."""
    H_cross: NDArray[np.float64]
    """(N, 6, N_SHARED) cross blocks of the information matrix, robot error by shared unknowns."""
    g_robot: NDArray[np.float64]
    """(N, 6) right-hand side of the robot error of each view."""
    H_reduced: NDArray[np.float64]
    """(N, N_SHARED, N_SHARED) information matrix of the shared unknowns from each view, after elimination of the robot
    error of the view."""
    g_reduced: NDArray[np.float64]
    """(N, N_SHARED) right-hand side of the shared unknowns from each view, after elimination of the robot error of the
    view."""
    H_prior: NDArray[np.float64]
    """(N_SHARED, N_SHARED) diagonal information matrix of the priors."""
    g_prior: NDArray[np.float64]
    """(N_SHARED,) right-hand side of the priors."""
    cost: float
    """Sum of squared whitened residuals: corners and robot errors of the used views, and the priors."""
    squares_px2: NDArray[np.float64]
    """(N,) sum of the squared reprojection residuals of each view, px^2."""

    def shared_information(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the information matrix (N_SHARED, N_SHARED) of the shared unknowns.

        Args:
            used: (N,) mask of the views to sum. The priors are added.
        """
        return self.H_reduced[used].sum(axis=0) + self.H_prior

    def shared_covariance(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the covariance (N_SHARED, N_SHARED) of the shared unknowns: the inverse of `shared_information`."""
        return invert_stack(self.shared_information(used))

    def robot_error_steps(self, shared: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the robot error steps (N, 6) for a given step `shared` (N_SHARED,) of the shared unknowns."""
        return solve_stack(self.H_robot, self.g_robot - self.H_cross @ shared)


@dataclass(frozen=True, eq=False)
class LinearisedCorners:
    """Normal equations of the corners alone, for a corner noise of one pixel."""

    unknowns: Unknowns
    """Linearisation point."""
    H: NDArray[np.float64]
    """(N, 6 + N_SHARED, 6 + N_SHARED) information matrix of each view: robot error, then shared unknowns."""
    g: NDArray[np.float64]
    """(N, 6 + N_SHARED) right-hand side of each view: robot error, then shared unknowns."""
    squares_px2: NDArray[np.float64]
    """(N,) sum of the squared reprojection residuals of each view, px^2."""
    cost_px2: NDArray[np.float64]
    """(N,) contribution of each view to the cost, px^2: `squares_px2`, weighted like the information."""


def linearise_corners(problem: Problem, unknowns: Unknowns, inliers: NDArray[np.bool_]) -> LinearisedCorners:
    """Linearise the reprojection residuals at `unknowns`, using the corners of the mask `inliers` (N, M)."""
    T_camera_board = unknowns.T_camera_board(problem)
    blocks = pixel_normal_equations(T_camera_board, unknowns.corrections, problem.corners, inliers)
    squares_px2 = blocks.squares_px2
    blocks = _discount_lens(blocks, problem.lens_weight)
    J = _unknowns_jacobian(problem, unknowns, T_camera_board)
    Jt = J.swapaxes(1, 2)
    return LinearisedCorners(
        unknowns=unknowns,
        H=Jt @ blocks.H @ J,
        g=np.matvec(Jt, blocks.g),
        squares_px2=squares_px2,
        cost_px2=blocks.squares_px2,
    )


def build_normal_equations(
    problem: Problem, corners: LinearisedCorners, used: NDArray[np.bool_], noise: NoiseLevel
) -> NormalEquations:
    """Build the normal equations of corners, robot errors and priors, and eliminate the robot errors.

    Args:
        problem: The measurements and priors.
        corners: Corner terms, linearised at the current unknowns.
        used: (N,) mask of the views that contribute to the cost.
        noise: Standard deviations of the corners and the robot errors.
    """
    weight = 1 / noise.pixel_px**2
    H = weight * corners.H
    g = weight * corners.g
    robot_errors = corners.unknowns.robot_errors
    corrections = corners.unknowns.corrections
    smooth_weights = corners.unknowns.smooth_weights
    H_robot = H[:, :6, :6] + np.diag(1 / noise.robot**2)
    H_cross = H[:, :6, 6:]
    g_robot = g[:, :6] - robot_errors / noise.robot**2
    elimination = np.linalg.solve(H_robot, np.concatenate([H_cross, g_robot[..., None]], axis=2))
    smooth_sigmas = noise.smooth_sigmas(len(smooth_weights))
    prior = np.concatenate([np.zeros(12), 1 / problem.correction_sigmas**2, 1 / smooth_sigmas**2])
    cost = (
        weight * corners.cost_px2[used].sum()
        + ((robot_errors[used] / noise.robot) ** 2).sum()
        + ((corrections / problem.correction_sigmas) ** 2).sum()
        + ((smooth_weights / smooth_sigmas) ** 2).sum()
    )
    return NormalEquations(
        H_robot=H_robot,
        H_cross=H_cross,
        g_robot=g_robot,
        H_reduced=H[:, 6:, 6:] - H_cross.swapaxes(1, 2) @ elimination[..., :-1],
        g_reduced=g[:, 6:] - (H_cross.swapaxes(1, 2) @ elimination[..., -1:])[..., 0],
        H_prior=np.diag(prior),
        g_prior=-prior * np.concatenate([np.zeros(12), corrections, smooth_weights]),
        cost=float(cost),
        squares_px2=corners.squares_px2,
    )


def board_motion_jacobian(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], T_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the Jacobians of the board motion in the camera frame with respect to the flange motion.

    Motions are twists: rotation (rad), then translation (m). A flange motion multiplies `T_base_flange` from the right.
    A board motion multiplies `T_camera_board` from the left.

    Args:
        mounting: Whether the camera is on the flange or in the cell.
        X: (4, 4) camera pose, as `HandEyeResult.X`.
        Y: (4, 4) board pose, as `HandEyeResult.Y`.
        T_camera_board: (N, 4, 4) board poses in the camera frame.

    Returns:
        (N, 6, 6) Jacobians, one per view.
    """
    if mounting == "eye-in-hand":
        return np.broadcast_to(-adjoint(invert_poses(X)), (len(T_camera_board), 6, 6))
    return adjoint(T_camera_board @ invert_poses(Y))


def implied_robot_errors(
    mounting: Mounting,
    T_base_flange: NDArray[np.float64],
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the robot errors that explain the observed board poses exactly.

    Args:
        mounting: Whether the camera is on the flange or in the cell.
        T_base_flange: (N, 4, 4) flange poses reported by the robot.
        X: (4, 4) or (N, 4, 4) camera poses, as `HandEyeResult.X`.
        Y: (4, 4) or (N, 4, 4) board poses, as `HandEyeResult.Y`.
        T_camera_board: (4, 4) or (N, 4, 4) observed board poses in the camera frame.

    Returns:
        (N, 4, 4) robot errors E: the true flange pose is `T_base_flange @ E`.
    """
    T_flange_base = invert_poses(T_base_flange)
    if mounting == "eye-in-hand":
        return T_flange_base @ Y @ invert_poses(T_camera_board) @ invert_poses(X)
    return T_flange_base @ X @ T_camera_board @ invert_poses(Y)


def _discount_lens(blocks: PixelNormalEquations, weight: float) -> PixelNormalEquations:
    """Multiply the information about the corrections that remains after elimination of the board pose by `weight`.

    The squares become the cost with this gradient: the squares with the best board pose are multiplied by `weight`.
    """
    if weight == 1.0:
        return blocks
    H = blocks.H.copy()
    g = blocks.g.copy()
    H_board = H[:, :6, :6] + BOARD_REGULARISATION * np.eye(6)
    elimination = np.linalg.solve(H_board, np.concatenate([H[:, :6, 6:], g[:, :6, None]], axis=2))
    explained = H[:, 6:, :6] @ elimination
    H[:, 6:, 6:] -= (1 - weight) * (H[:, 6:, 6:] - explained[..., :-1])
    g[:, 6:] -= (1 - weight) * (g[:, 6:] - explained[..., -1])
    gain_px2 = np.vecdot(blocks.g[:, :6], elimination[..., -1])
    return replace(blocks, H=H, g=g, squares_px2=weight * blocks.squares_px2 + (1 - weight) * gain_px2)


def _unknowns_jacobian(
    problem: Problem, unknowns: Unknowns, T_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return Jacobians (N, 6 + N_CORRECTIONS, 6 + N_SHARED) of the board pose in each view, and of the corrections.

    The columns are the robot error of the view (6), then the shared unknowns. The board pose is a twist in the camera
    frame.
    """
    modes = problem.smooth_modes
    J = np.zeros((len(T_camera_board), 6 + N_CORRECTIONS, 6 + N_SHARED + modes.shape[2]))
    J_flange = board_motion_jacobian(problem.mounting, unknowns.X, unknowns.Y, T_camera_board)
    J[:, :6, :6] = J_flange @ right_jacobian(unknowns.all_robot_errors(problem))
    J[:, :6, 6:12] = -np.eye(6)
    J[:, :6, 12:18] = adjoint(T_camera_board)
    J[:, 6:, 18 : 6 + N_SHARED] = np.eye(N_CORRECTIONS)
    J[:, :6, 6 + N_SHARED :] = J[:, :6, :6] @ modes
    return J
