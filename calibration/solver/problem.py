"""The adjustment's unknowns and normal equations.

Of view i, with the flange told at A_i and truly at A_i E_i, the board is in the camera at

    C_i = X^-1 (A_i E_i)^-1 Y    camera on the flange
    C_i = X^-1 (A_i E_i) Y       camera in the cell

so that small motions x of X and y of Y, from the right as everywhere, and d of E_i move it from the left by
-x + adjoint(C_i) y + `carried_i` d. The robot's errors are eliminated view by view (a Schur complement of 6x6 blocks).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, pose_from_twist, right_jacobian, solve_stack
from calibration.observations import Mounting
from calibration.pose_estimation.projection import LENS, Corners, pixel_blocks
from calibration.solver.noise import NoiseLevel, NoisePriors

SHARED = 12 + LENS
"""Unknowns that all views share: x, y and the lens."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is given: views that are used, and those that are only looked at."""

    corners: Corners
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4)."""
    mounting: Mounting
    assumed: NoisePriors

    @property
    def prior(self) -> NDArray[np.float64]:
        """(LENS,) standard deviations."""
        return np.array([self.assumed.focal] * 2 + [self.assumed.centre] * 2 + [self.assumed.scale])


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is solved for."""

    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    errors: NDArray[np.float64]
    """(N, 6) of the robot, in the flange's frame: truly it was at `T_base_flange @ small_motion(error)`."""
    lens: NDArray[np.float64]
    """(LENS,)."""

    def T_camera_board(self, problem: Problem) -> NDArray[np.float64]:
        """(N, 4, 4)."""
        flange = problem.T_base_flange @ pose_from_twist(self.errors)
        return invert_poses(self.X) @ (flange if problem.mounting == "eye-to-hand" else invert_poses(flange)) @ self.Y

    def moved(self, shared: NDArray[np.float64], errors: NDArray[np.float64]) -> "Unknowns":
        """After a step of the shared unknowns (SHARED,) and of the errors (N, 6)."""
        return Unknowns(
            self.X @ pose_from_twist(shared[:6]),
            self.Y @ pose_from_twist(shared[6:12]),
            self.errors + errors,
            self.lens + shared[12:],
        )


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations around some unknowns; of views that are not used only by themselves."""

    own: NDArray[np.float64]
    """(N, 6, 6) of each view's robot error."""
    mixed: NDArray[np.float64]
    """(N, 6, SHARED)."""
    pull: NDArray[np.float64]
    """(N, 6) right-hand side."""
    reduced: NDArray[np.float64]
    """(N, SHARED, SHARED) what each view says of the shared unknowns, its robot error eliminated."""
    reduced_pull: NDArray[np.float64]
    """(N, SHARED)."""
    prior: NDArray[np.float64]
    """(SHARED, SHARED) diagonal."""
    prior_pull: NDArray[np.float64]
    """(SHARED,)."""
    cost: float
    """Sum of squares in standard deviations, of the views used."""
    squares: NDArray[np.float64]
    """(N,) sum of the squared reprojection errors, px^2."""

    def shared_information(self, used: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(SHARED, SHARED) inverse covariance of the shared unknowns by the views `used` (N,)."""
        return self.reduced[used].sum(axis=0) + self.prior

    def errors_step(self, shared: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 6) the robot errors' step that goes with a step of the shared unknowns."""
        return solve_stack(self.own, self.pull - self.mixed @ shared)


@dataclass(frozen=True, eq=False)
class CornerTerms:
    """What the corners say around some unknowns, for pixels of unit noise."""

    unknowns: Unknowns
    information: NDArray[np.float64]
    """(N, 6 + SHARED, 6 + SHARED) of each view's robot error and the shared unknowns."""
    pull: NDArray[np.float64]
    """(N, 6 + SHARED)."""
    squares: NDArray[np.float64]
    """(N,) px^2."""


def corner_terms(problem: Problem, unknowns: Unknowns, good: NDArray[np.bool_]) -> CornerTerms:
    """What the corners `good` (N, M) say around `unknowns`."""
    T_camera_board = unknowns.T_camera_board(problem)
    blocks = pixel_blocks(T_camera_board, unknowns.lens, problem.corners, good)
    J = _by_unknown(problem, unknowns, T_camera_board)
    Jt = J.swapaxes(1, 2)
    return CornerTerms(unknowns, Jt @ blocks.information @ J, (Jt @ blocks.pull[..., None])[..., 0], blocks.squares)


def normal_equations(
    problem: Problem, measured: CornerTerms, used: NDArray[np.bool_], noise: NoiseLevel
) -> NormalEquations:
    """The normal equations with the corners, the robot and the priors in their standard deviations."""
    weight = 1 / noise.pixel_px**2
    N, g, errors, lens = (
        weight * measured.information,
        weight * measured.pull,
        measured.unknowns.errors,
        measured.unknowns.lens,
    )
    own = N[:, :6, :6] + np.diag(1 / noise.robot**2)
    mixed = N[:, :6, 6:]
    pull = g[:, :6] - errors / noise.robot**2
    reduction = np.linalg.solve(own, np.concatenate([mixed, pull[..., None]], axis=2))
    prior = np.concatenate([np.zeros(12), 1 / problem.prior**2])
    cost = (
        weight * measured.squares[used].sum()
        + ((errors[used] / noise.robot) ** 2).sum()
        + ((lens / problem.prior) ** 2).sum()
    )
    return NormalEquations(
        own=own,
        mixed=mixed,
        pull=pull,
        reduced=N[:, 6:, 6:] - mixed.swapaxes(1, 2) @ reduction[..., :-1],
        reduced_pull=g[:, 6:] - (mixed.swapaxes(1, 2) @ reduction[..., -1:])[..., 0],
        prior=np.diag(prior),
        prior_pull=-prior * np.concatenate([np.zeros(12), lens]),
        cost=float(cost),
        squares=measured.squares,
    )


def board_motion_jacobian(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], T_camera_board: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 6, 6) how the flange's small motion, from the right, moves the board in the camera, from the left."""
    if mounting == "eye-in-hand":
        return np.broadcast_to(-adjoint(invert_poses(X)), (len(T_camera_board), 6, 6))
    return adjoint(T_camera_board @ invert_poses(Y))


def robot_error(
    mounting: Mounting,
    T_base_flange: NDArray[np.float64],
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(N, 4, 4) where the flange was, in the told flange frame, for the board to be seen at `T_camera_board`."""
    told = invert_poses(T_base_flange)
    if mounting == "eye-in-hand":
        return told @ Y @ invert_poses(T_camera_board) @ invert_poses(X)
    return told @ X @ T_camera_board @ invert_poses(Y)


def _by_unknown(problem: Problem, unknowns: Unknowns, T_camera_board: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 6 + LENS, 6 + SHARED) the board's motion in the camera and the lens, by the error, X, Y and the lens."""
    J = np.zeros((len(T_camera_board), 6 + LENS, 6 + SHARED))
    moved = board_motion_jacobian(problem.mounting, unknowns.X, unknowns.Y, T_camera_board)
    J[:, :6, :6] = moved @ right_jacobian(unknowns.errors)
    J[:, :6, 6:12] = -np.eye(6)
    J[:, :6, 12:18] = adjoint(T_camera_board)
    J[:, 6:, 18:] = np.eye(LENS)
    return J
