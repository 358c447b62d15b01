"""Evidence for the assessment of a solved calibration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.view_reports import distances_m
from calibration.observations import Mounting, Observations
from calibration.pose_estimation.board_pose import BoardPoses
from calibration.pose_estimation.projection import camera_matrix
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.cross_validation import CrossValidation
from calibration.solver.problem import Problem
from calibration.solver.residual_distortion import estimate_residual_distortion


@dataclass(frozen=True, eq=False)
class Evidence:
    """A solved calibration and the views that it was solved from."""

    mounting: Mounting
    """Whether the camera is on the flange or stands in the cell."""
    names: tuple[str, ...]
    """Names of the N views, in the given order."""
    T_base_flange: NDArray[np.float64]
    """(N, 4, 4) flange poses that the robot reported."""
    T_camera_board: NDArray[np.float64]
    """(N, 4, 4) board pose of each view alone, with the given intrinsics and board; NaN without a pose."""
    used: NDArray[np.bool_]
    """(N,) whether the calibration was solved from the view."""
    distance_m: NDArray[np.float64]
    """(N,) distance from the camera to the middle of the board, metres; NaN without a pose."""
    X: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    Y: NDArray[np.float64]
    """(4, 4) as in `HandEyeResult`."""
    covariance: NDArray[np.float64]
    """(6, 6) covariance of X as in `HandEyeResult`, without the share of an unverified board size."""
    robot_sigma_m: float
    """Estimated noise of the flange positions along one axis, metres, one sigma."""
    robot_sigma_rad: float
    """Estimated noise of the flange rotations about one axis, radians, one sigma."""
    loo_error_m: float
    """Leave-one-out error of the used views, root mean square, metres."""
    lever_m: NDArray[np.float64]
    """(3,) vector from the flange to the middle of the board along the axes of the camera, metres."""
    pixel_sigma_px: float
    """Estimated noise of one coordinate of a corner, pixels."""
    K_nominal: NDArray[np.float64]
    """(3, 3) pinhole matrix that the camera reports, pixels."""
    K: NDArray[np.float64]
    """(3, 3) fitted pinhole matrix, pixels."""
    k1: float
    """Residual radial distortion of the images, as in `ResidualDistortion`."""
    k1_sigma: float
    """One sigma of `k1`."""
    board_scale: float
    """Estimated size of the board, as a share of the given size."""
    board_scale_sigma: float
    """One sigma of `board_scale`."""
    converged: bool
    """False if the solution still moved after the last step, or if no step decreased the cost."""


def collect_evidence(
    observations: Observations,
    problem: Problem,
    board_poses: BoardPoses,
    adjusted: Adjustment,
    cross_validation: CrossValidation,
) -> Evidence:
    """Collect the evidence of a solved calibration.

    Args:
        observations: The views, the board and the camera.
        problem: The problem that was solved.
        board_poses: Board pose of each view alone.
        adjusted: The solution.
        cross_validation: The solution without each of the views.
    """
    unknowns, used = adjusted.unknowns, adjusted.used
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
        robot_sigma_m=adjusted.noise.robot_m,
        robot_sigma_rad=adjusted.noise.robot_rad,
        loo_error_m=_rms(cross_validation.loo_error_m[used]),
        lever_m=_lever(problem.mounting, unknowns.X, unknowns.Y, problem.corners.middle, distance_m),
        pixel_sigma_px=adjusted.noise.pixel_px,
        K_nominal=observations.K,
        K=camera_matrix(observations.K, unknowns.lens),
        k1=radial.k1,
        k1_sigma=radial.sigma,
        board_scale=adjusted.board_scale,
        board_scale_sigma=adjusted.board_scale_sigma,
        converged=adjusted.converged,
    )


def _lever(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], middle: NDArray[np.float64], distance_m: float
) -> NDArray[np.float64]:
    """Return the vector (3,) from the flange to the middle of the board along the axes of the camera, metres."""
    if mounting == "eye-in-hand":
        return np.array([0.0, 0.0, distance_m]) + X[:3, :3].T @ X[:3, 3]
    return np.array([0.0, 0.0, np.linalg.norm(Y[:3, :3] @ middle + Y[:3, 3])])


def _rms(values: NDArray[np.float64]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))
