"""The weighted solution from poses alone: X and Y, with the noise of the robot's and of the camera's poses estimated.

The robot errs along and about the flange's axes; the camera errs in how the board is tilted and, less, how it is turned
in its plane, both about its origin, in where it is across the view, and, more, along it. How these six add up in a
view depends on where everything is, which is what tells them apart. Their levels are variance components of the
residuals; a view that is far off for its noise counts less (Student's distribution), so that a heavy tail does no harm,
and one that is beyond chance is left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import (
    adjoint,
    cross_matrix,
    invert_poses,
    invert_stack,
    pose_from_twist,
    right_jacobian,
    twist_from_pose,
)
from calibration.observations import Mounting
from calibration.solver.cross_validation import board_discrepancy
from calibration.solver.noise import NoisePriors
from calibration.solver.problem import board_motion_jacobian, robot_error

CAMERA_TILT_RAD, CAMERA_SPIN_RAD = np.radians(0.05), np.radians(0.02)
CAMERA_ACROSS_M, CAMERA_ALONG_M = 5e-5, 2e-4
"""Where the estimation of the camera's noise starts: a sheet of paper at 0.4 m."""
PRIOR_ERRORS = 0.5
"""The start counts as this many errors beside those of the views."""
TAIL = 8.0
"""Degrees of freedom of Student's distribution."""
STEPS = 60
SETTLED = 1e-2
"""X and Y move by less than this share of their standard deviation ..."""
NOISE_SETTLED = 0.05
"""... and no noise level by more than so many errors' worth of evidence: those near zero shrink for ever."""
LEAST = 1e-7
"""Standard deviations end here, rad and m, where poses are exact."""
LEAVES = 1e-7
"""A view is left out that is as far off by chance less often than this, by the tail assumed."""


@dataclass(frozen=True, eq=False)
class Poses:
    """What is given."""

    T_base_flange: NDArray[np.float64]
    """(N, 4, 4)."""
    T_camera_board: NDArray[np.float64]
    """(N, 4, 4)."""
    mounting: Mounting

    @property
    def A(self) -> NDArray[np.float64]:
        """(N, 4, 4) as `calibration.solver.initialisation` means it."""
        return self.T_base_flange if self.mounting == "eye-in-hand" else invert_poses(self.T_base_flange)

    @property
    def distances_m(self) -> NDArray[np.float64]:
        """(N,) from the camera to the board's origin."""
        return np.linalg.norm(self.T_camera_board[:, :3, 3], axis=1)


@dataclass(frozen=True, eq=False)
class PoseSolution:
    """X and Y, and how sure they are."""

    X: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    Y: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    covariance: NDArray[np.float64]
    """(12, 12) of small motions of X, then of Y, from the right."""
    sigmas: NDArray[np.float64]
    """(6,) noise: robot rad and m; camera rad of tilt and in the plane, m across and along the view."""
    used: NDArray[np.bool_]
    """(N,)."""
    errors: NDArray[np.float64]
    """(N, 6) of the robot, as far as they are the robot's by the noise levels."""
    left_out: NDArray[np.float64]
    """(N, 6) where the robot was by the board's pose in this view and the other views' solution, told flange frame."""
    off_m: NDArray[np.float64]
    """(N,) how far off the board's origin is in this view by the other views' solution."""


def solve_weighted(poses: Poses, X: NDArray[np.float64], Y: NDArray[np.float64], assumed: NoisePriors) -> PoseSolution:
    """The solution from rough `X` and `Y` (4, 4) on; it may still move when the steps are used up, as noise levels do
    that hardly matter."""
    camera = [CAMERA_TILT_RAD, CAMERA_SPIN_RAD, CAMERA_ACROSS_M, CAMERA_ALONG_M]
    told = np.array([assumed.robot_rad, assumed.robot_m, *camera]) ** 2
    variances = told.copy()
    weights = np.ones(len(poses.T_base_flange))
    for _ in range(STEPS):
        r, J, parts = _residuals(poses, X, Y)
        W = invert_stack(np.tensordot(variances, parts, axes=1))
        squares = (r * (W @ r[..., None])[..., 0]).sum(axis=1)
        weights = np.where(_within(squares), (TAIL + 6) / (TAIL + squares), 0.0)
        W *= weights[:, None, None]
        JtW = J.swapaxes(1, 2) @ W
        information = (JtW @ J).sum(axis=0)
        step = np.linalg.solve(information, -(JtW @ r[..., None]).sum(axis=0)[:, 0])
        X, Y = X @ pose_from_twist(step[:6]), Y @ pose_from_twist(step[6:])
        still = float(np.sqrt(step @ information @ step)) < SETTLED
        if assumed.estimate_noise:
            variances, change = _variances(variances, told, r + J @ step, W, weights, JtW, information, parts)
            still &= change < NOISE_SETTLED
        if still:
            break
    return _solution(poses, X, Y, variances, weights)


def _solution(
    poses: Poses,
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    variances: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> PoseSolution:
    """X and Y as they are, with what the views, each with its weight (N,), say of them and of one another."""
    r, J, parts = _residuals(poses, X, Y)
    W = invert_stack(np.tensordot(variances, parts, axes=1))
    JtW = weights[:, None, None] * J.swapaxes(1, 2) @ W
    by_view, pulls = JtW @ J, -(JtW @ r[..., None])
    information = by_view.sum(axis=0)
    others = information - by_view + 1e-12 * np.diag(np.diag(information))
    without = np.linalg.solve(others, pulls.sum(axis=0) - pulls)[..., 0]
    X_others, Y_others = X @ pose_from_twist(without[:, :6]), Y @ pose_from_twist(without[:, 6:])
    apart = board_discrepancy(poses.mounting, poses.T_base_flange, X_others, Y_others, poses.T_camera_board)
    return PoseSolution(
        X=X,
        Y=Y,
        covariance=invert_stack(information),
        sigmas=np.sqrt(variances),
        used=weights > 0,
        errors=np.repeat(variances[:2], 3) * (W @ r[..., None])[..., 0],
        left_out=r + (J @ without[..., None])[..., 0],
        off_m=np.linalg.norm(apart[:, :3, 3], axis=1),
    )


def _residuals(
    poses: Poses, X: NDArray[np.float64], Y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(N, 6) the robot's errors if the camera made none; (N, 6, 12) how X and Y change them; (6, N, 6, 6) what noise
    of unit variance adds to their covariance, source by source."""
    C = poses.T_camera_board
    r = twist_from_pose(robot_error(poses.mounting, poses.T_base_flange, X, Y, C))
    back = invert_stack(right_jacobian(r)) @ invert_stack(board_motion_jacobian(poses.mounting, X, Y, C))
    eye = np.broadcast_to(np.eye(6), (len(C), 6, 6))
    J = back @ np.concatenate([eye, -adjoint(C)], axis=2)
    about_board = eye.copy()
    about_board[:, :3, :3] = C[:, :3, :3]
    about_board[:, 3:, :3] = cross_matrix(C[:, :3, 3]) @ C[:, :3, :3]
    camera = back @ about_board
    sources = [eye[..., :3], eye[..., 3:], camera[..., :2], camera[..., 2:3], camera[..., 3:5], camera[..., 5:]]
    return r, J, np.array([source @ source.swapaxes(1, 2) for source in sources])


def _within(squares: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which views are no farther off than the tail explains; at least half of them, and three, stay."""
    from scipy.special import fdtri

    limit = 6 * float(fdtri(6, TAIL, 1 - LEAVES))
    fewest = max(len(squares) // 2, 3)
    return squares <= max(limit, float(np.sort(squares)[min(fewest, len(squares)) - 1]))


def _variances(
    variances: NDArray[np.float64],
    told: NDArray[np.float64],
    r: NDArray[np.float64],
    W: NDArray[np.float64],
    weights: NDArray[np.float64],
    JtW: NDArray[np.float64],
    information: NDArray[np.float64],
    parts: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:
    """(6,) one step towards the restricted maximum likelihood: each variance times the ratio of what its part of the
    residuals is to what it would be; and by how many errors' worth the most changed differs."""
    weighted = (W @ r[..., None])[..., 0]
    # A view of weight w has 1/w times the covariance of the others.
    share = 1 / np.maximum(weights, 1e-12)
    spread = (weighted * (parts @ weighted[..., None])[..., 0]).sum(axis=2) @ share
    hat = W - JtW.swapaxes(1, 2) @ invert_stack(information) @ JtW
    expected = (hat * parts).sum(axis=(2, 3)) @ share
    spread += PRIOR_ERRORS * told / variances**2
    expected += PRIOR_ERRORS / variances
    better = np.maximum(variances * spread / expected, LEAST**2)
    return better, float(np.max(np.abs(better - variances) * expected))
