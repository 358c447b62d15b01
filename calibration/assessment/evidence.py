"""Evidence for the assessment of a solved calibration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.view_reports import distances_m
from calibration.observations import Mounting, Observations
from calibration.pose_estimation.board_pose import BoardPoses
from calibration.pose_estimation.projection import camera_matrix
from calibration.solver.outlier_rejection import ConsistentSolution
from calibration.solver.problem import Problem
from calibration.solver.residual_distortion import estimate_residual_distortion


@dataclass(frozen=True, eq=False)
class Evidence:
    """Solution of a calibration and all its views, as input of the assessment."""

    mounting: Mounting
    """Whether the camera is on the flange or in the cell."""
    names: tuple[str, ...]
    """Names of the N views, in the given order."""
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4) flange poses reported by the robot, base frame, metres."""
    T_camera_board: NDArray[np.float64]
    """(N, 4, 4) board poses, each estimated from one view alone with the given intrinsics and the nominal board size;
    NaN without a board pose."""
    used: NDArray[np.bool_]
    """(N,) mask, True for the views that the solution uses."""
    distance_m: NDArray[np.float64]
    """(N,) distance from the camera to the middle of the board, metres; NaN without a board pose."""
    X: NDArray[np.float64]
    """(4, 4) camera pose, as `HandEyeResult.X`."""
    Y: NDArray[np.float64]
    """(4, 4) board pose, as `HandEyeResult.Y`."""
    covariance: NDArray[np.float64]
    """(6, 6) covariance of the error of X, as `HandEyeResult.covariance`, but without the uncertainty of an unverified
    board size."""
    robot_sigma_m: float
    """Estimated root mean square of the robot position error per axis in the used views, metres."""
    robot_sigma_rad: float
    """Estimated root mean square of the robot rotation error per axis in the used views, radians."""
    loo_error_m: float
    """Root mean square of the leave-one-out errors of the used views, metres."""
    lever_m: NDArray[np.float64]
    """(3,) vector from the flange to the middle of the board in camera axes, metres; approximate, see `_lever`."""
    pixel_sigma_px: float
    """Estimated standard deviation of the corner noise per image coordinate, pixels."""
    K_nominal: NDArray[np.float64]
    """(3, 3) pinhole matrix reported by the camera, pixels."""
    K: NDArray[np.float64]
    """(3, 3) fitted pinhole matrix, pixels."""
    k1: float
    """Radial distortion coefficient k1 that remains in the residuals, as `ResidualDistortion.k1`."""
    k1_sigma: float
    """Standard deviation of `k1`; infinite if the views do not determine `k1`."""
    board_scale: float
    """Estimated size of the board divided by its nominal size."""
    board_scale_sigma: float
    """Standard deviation of `board_scale`."""
    converged: bool
    """Whether the adjustment converged, as `Adjustment.converged`."""


def collect_evidence(
    observations: Observations,
    problem: Problem,
    board_poses: BoardPoses,
    solution: ConsistentSolution,
) -> Evidence:
    """Collect the evidence of a solved calibration.

    Args:
        observations: Board, camera and views of the calibration.
        problem: Measurements and priors of the calibration.
        board_poses: Board poses, each estimated from one view alone.
        solution: Solution of the calibration, with its cross-validation.
    """
    adjusted = solution.adjusted
    unknowns = adjusted.unknowns
    used = adjusted.used
    smooth_errors = (problem.smooth_modes @ unknowns.smooth_weights)[used]
    distances = distances_m(problem, board_poses)
    radial = estimate_residual_distortion(problem, adjusted)
    distance_m = float(distances[used].mean())
    return Evidence(
        mounting=problem.mounting,
        names=tuple(view.name for view in observations.views),
        T_base_flange=problem.T_base_flange,
        T_camera_board=board_poses.T_camera_board,
        used=used,
        distance_m=distances,
        X=unknowns.X,
        Y=unknowns.Y,
        covariance=adjusted.shared_covariance[:6, :6],
        robot_sigma_m=float(np.hypot(adjusted.noise.robot_m, _rms(smooth_errors[:, 3:]))),
        robot_sigma_rad=float(np.hypot(adjusted.noise.robot_rad, _rms(smooth_errors[:, :3]))),
        loo_error_m=_rms(solution.cross_validation.loo_error_m[used]),
        lever_m=_lever(problem.mounting, unknowns.X, unknowns.Y, problem.corners.middle, distance_m),
        pixel_sigma_px=adjusted.noise.pixel_px,
        K_nominal=observations.K,
        K=camera_matrix(observations.K, unknowns.corrections),
        k1=radial.k1,
        k1_sigma=radial.sigma,
        board_scale=adjusted.board_scale,
        board_scale_sigma=adjusted.board_scale_sigma,
        converged=adjusted.converged,
    )


def _lever(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], middle: NDArray[np.float64], distance_m: float
) -> NDArray[np.float64]:
    """Return the vector (3,) from the flange to the middle of the board in camera axes, metres.

    Eye-in-hand: the board is assumed on the optical axis at `distance_m`. Eye-to-hand: the
    length is exact, and the direction is assumed along the optical axis.
    """
    if mounting == "eye-in-hand":
        return np.array([0.0, 0.0, distance_m]) + X[:3, :3].T @ X[:3, 3]
    return np.array([0.0, 0.0, np.linalg.norm(Y[:3, :3] @ middle + Y[:3, 3])])


def _rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square of `values`."""
    return float(np.sqrt(np.mean(values**2)))
