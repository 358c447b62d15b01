"""The unknowns of the bundle adjustment and its normal equations.

The controller reports the flange pose A_i of view i. The true pose is A_i E_i, with a small robot error E_i. The board
is in the camera frame at

    C_i = X^-1 (A_i E_i)^-1 Y    camera on the flange (eye-in-hand)
    C_i = X^-1 (A_i E_i) Y       camera in the cell (eye-to-hand)

Small motions x of X, y of Y and e of E_i multiply from the right. To first order they are equivalent to a twist that
multiplies C_i from the left, which is -x + adjoint(C_i) y + `board_motion_jacobian` e. The robot errors are eliminated
view by view (Schur complement of 6x6 blocks).

H is an information matrix (J^T W J) and g the right-hand side (J^T W r) of normal equations H step = g.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, invert_stack, pose_from_twist, right_jacobian, solve_stack
from calibration.observations import Mounting
from calibration.pose_estimation.projection import N_LENS, Corners, pixel_normal_equations
from calibration.solver.noise import NoiseLevel, NoisePriors

N_SHARED = 12 + N_LENS
"""Number of unknowns that all views share: 6 of X, 6 of Y, and those of the lens and the scale of the board."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Measurements and priors of a calibration, of all views, whether the solution uses them or not."""

    corners: Corners
    """The measured corners of N views with M board points."""
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4) flange poses that the robot reported, metres."""
    mounting: Mounting
    """Whether the camera is on the flange or stands in the cell."""
    priors: NoisePriors
    """Standard deviations of the noise and of the lens and the board."""

    @property
    def lens_sigmas(self) -> NDArray[np.float64]:
        """(N_LENS,) prior standard deviations of the lens and of the logarithm of the scale of the board."""
        return np.array([self.priors.focal] * 2 + [self.priors.centre] * 2 + [self.priors.scale])


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values of everything that the adjustment solves for."""

    X: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    Y: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    robot_errors: NDArray[np.float64]
    """(N, 6) twists, radians and metres. The true flange pose is `T_base_flange @ pose_from_twist(robot_error)`."""
    lens: NDArray[np.float64]
    """(N_LENS,) corrections of the lens and logarithm of the scale of the board, as in `projection.camera_matrix`."""

    def T_camera_board(self, problem: Problem) -> NDArray[np.float64]:
        """Return the (N, 4, 4) board poses in the camera frame."""
        flange = problem.T_base_flange @ pose_from_twist(self.robot_errors)
        return invert_poses(self.X) @ (flange if problem.mounting == "eye-to-hand" else invert_poses(flange)) @ self.Y

    def add_step(self, shared: NDArray[np.float64], robot_errors: NDArray[np.float64]) -> "Unknowns":
        """Return the unknowns after a step of the shared unknowns (N_SHARED,) and of the robot errors (N, 6)."""
        return Unknowns(
            self.X @ pose_from_twist(shared[:6]),
            self.Y @ pose_from_twist(shared[6:12]),
            self.robot_errors + robot_errors,
            self.lens + shared[12:],
        )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations around some unknowns, weighted with the noise. Views that are not used have their own blocks."""

    H_robot: NDArray[np.float64]
    """(N, 6, 6) information about the robot error of each view."""
    H_cross: NDArray[np.float64]
    """(N, 6, N_SHARED) blocks between the robot error and the shared unknowns."""
    g_robot: NDArray[np.float64]
    """(N, 6) right-hand side of the robot errors."""
    H_reduced: NDArray[np.float64]
    """(N, N_SHARED, N_SHARED) information of each view about the shared unknowns, its robot error eliminated."""
    g_reduced: NDArray[np.float64]
    """(N, N_SHARED) right-hand side of the shared unknowns, the robot errors eliminated."""
    H_prior: NDArray[np.float64]
    """(N_SHARED, N_SHARED) diagonal information of the priors."""
    g_prior: NDArray[np.float64]
    """(N_SHARED,) right-hand side of the priors."""
    cost: float
    """Sum of squares in standard deviations, over the views used."""
    squares_px2: NDArray[np.float64]
    """(N,) sum of the squared reprojection errors, px^2."""

    def shared_information(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the (N_SHARED, N_SHARED) information about the shared unknowns from the views `used` (N,)."""
        return self.H_reduced[used].sum(axis=0) + self.H_prior

    def shared_covariance(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the (N_SHARED, N_SHARED) covariance of the shared unknowns from the views `used` (N,)."""
        return invert_stack(self.shared_information(used))

    def robot_error_steps(self, shared: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (N, 6) steps of the robot errors for a step (N_SHARED,) of the shared unknowns."""
        return solve_stack(self.H_robot, self.g_robot - self.H_cross @ shared)


@dataclass(frozen=True, eq=False)
class LinearisedCorners:
    """Normal equations of the corners alone around some unknowns, for pixels of unit noise."""

    unknowns: Unknowns
    """Where the corners were linearised."""
    H: NDArray[np.float64]
    """(N, 6 + N_SHARED, 6 + N_SHARED) information about the robot error of each view and the shared unknowns."""
    g: NDArray[np.float64]
    """(N, 6 + N_SHARED) right-hand side."""
    squares_px2: NDArray[np.float64]
    """(N,) sum of the squared reprojection errors, px^2."""


def linearise_corners(problem: Problem, unknowns: Unknowns, inliers: NDArray[np.bool_]) -> LinearisedCorners:
    """Linearise the reprojection of the corners `inliers` (N, M) around `unknowns`."""
    T_camera_board = unknowns.T_camera_board(problem)
    blocks = pixel_normal_equations(T_camera_board, unknowns.lens, problem.corners, inliers)
    J = _unknowns_jacobian(problem, unknowns, T_camera_board)
    Jt = J.swapaxes(1, 2)
    return LinearisedCorners(unknowns, Jt @ blocks.H @ J, np.matvec(Jt, blocks.g), blocks.squares_px2)


def build_normal_equations(
    problem: Problem, corners: LinearisedCorners, used: NDArray[np.bool_], noise: NoiseLevel
) -> NormalEquations:
    """Weight the corners, the robot errors and the priors with their standard deviations, and eliminate the robot.

    Args:
        problem: The measurements and priors.
        corners: The corners, linearised around some unknowns.
        used: (N,) views that count in the cost.
        noise: Standard deviations of the corners and the robot.
    """
    weight = 1 / noise.pixel_px**2
    H, g = weight * corners.H, weight * corners.g
    robot_errors, lens = corners.unknowns.robot_errors, corners.unknowns.lens
    H_robot = H[:, :6, :6] + np.diag(1 / noise.robot**2)
    H_cross = H[:, :6, 6:]
    g_robot = g[:, :6] - robot_errors / noise.robot**2
    elimination = np.linalg.solve(H_robot, np.concatenate([H_cross, g_robot[..., None]], axis=2))
    prior = np.concatenate([np.zeros(12), 1 / problem.lens_sigmas**2])
    cost = (
        weight * corners.squares_px2[used].sum()
        + ((robot_errors[used] / noise.robot) ** 2).sum()
        + ((lens / problem.lens_sigmas) ** 2).sum()
    )
    return NormalEquations(
        H_robot=H_robot,
        H_cross=H_cross,
        g_robot=g_robot,
        H_reduced=H[:, 6:, 6:] - H_cross.swapaxes(1, 2) @ elimination[..., :-1],
        g_reduced=g[:, 6:] - (H_cross.swapaxes(1, 2) @ elimination[..., -1:])[..., 0],
        H_prior=np.diag(prior),
        g_prior=-prior * np.concatenate([np.zeros(12), lens]),
        cost=float(cost),
        squares_px2=corners.squares_px2,
    )


def board_motion_jacobian(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], T_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (N, 6, 6) derivative of the board's motion in the camera with respect to the flange's motion.

    Args:
        mounting: Whether the camera is on the flange or stands in the cell.
        X: (4, 4) as in `HandEyeResult`.
        Y: (4, 4) as in `HandEyeResult`.
        T_camera_board: (N, 4, 4) board poses in the camera frame.

    Returns:
        Jacobians from a small motion of the flange, from the right, to that of the board, from the left.
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
    """Return the robot errors with which the board appears exactly at `T_camera_board`.

    Args:
        mounting: Whether the camera is on the flange or stands in the cell.
        T_base_flange: (N, 4, 4) flange poses that the robot reported.
        X: (4, 4) or (N, 4, 4) as in `HandEyeResult`.
        Y: (4, 4) or (N, 4, 4) as in `HandEyeResult`.
        T_camera_board: (N, 4, 4) or (4, 4) board poses in the camera frame.

    Returns:
        (N, 4, 4) true flange poses in the reported flange frames.
    """
    T_flange_base = invert_poses(T_base_flange)
    if mounting == "eye-in-hand":
        return T_flange_base @ Y @ invert_poses(T_camera_board) @ invert_poses(X)
    return T_flange_base @ X @ T_camera_board @ invert_poses(Y)


def _unknowns_jacobian(
    problem: Problem, unknowns: Unknowns, T_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (N, 6 + N_LENS, 6 + N_SHARED) derivative of board motion and lens with respect to all unknowns."""
    J = np.zeros((len(T_camera_board), 6 + N_LENS, 6 + N_SHARED))
    J_flange = board_motion_jacobian(problem.mounting, unknowns.X, unknowns.Y, T_camera_board)
    J[:, :6, :6] = J_flange @ right_jacobian(unknowns.robot_errors)
    J[:, :6, 6:12] = -np.eye(6)
    J[:, :6, 12:18] = adjoint(T_camera_board)
    J[:, 6:, 18:] = np.eye(N_LENS)
    return J
