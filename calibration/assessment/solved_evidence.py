"""What the gates are shown of a solution."""

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.evidence import Evidence
from calibration.assessment.view_reports import distances_m
from calibration.observations import Mounting, Observations
from calibration.pose_estimation.board_pose import BoardPoses
from calibration.pose_estimation.projection import camera_matrix
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.cross_validation import CrossValidation
from calibration.solver.pose_solution import Poses, PoseSolution
from calibration.solver.problem import Problem
from calibration.solver.residual_distortion import estimate_residual_distortion


def collect_evidence(
    observations: Observations, problem: Problem, alone: BoardPoses, adjusted: Adjustment, left_out: CrossValidation
) -> Evidence:
    """Of a solution from pictures."""
    unknowns, used = adjusted.unknowns, adjusted.used
    covariance = adjusted.shared_covariance[:6, :6]
    distances = distances_m(problem, alone)
    noise = adjusted.noise
    radial = estimate_residual_distortion(problem, adjusted)
    lever = _lever(problem.mounting, unknowns.X, unknowns.Y, problem.corners.middle, _mean(distances[used]))
    return Evidence(
        mounting=problem.mounting,
        names=tuple(view.name for view in observations.views),
        T_base_flange=problem.T_base_flange,
        T_camera_board=alone.T_camera_board,
        used=used,
        distance_m=distances,
        X=unknowns.X,
        Y=unknowns.Y,
        covariance=covariance,
        robot_sigma_m=noise.robot_m,
        robot_sigma_rad=noise.robot_rad,
        left_out_m=_rms(left_out.off_m[used]),
        lever_m=lever,
        pixel_sigma_px=noise.pixel_px,
        K_told=observations.K,
        K=camera_matrix(observations.K, unknowns.lens),
        k1=radial.k1,
        k1_sigma=radial.sigma,
        board_scale=adjusted.board_scale,
        board_scale_sigma=adjusted.board_scale_sigma,
        settled=adjusted.settled,
    )


def pose_evidence(names: tuple[str, ...], poses: Poses, solution: PoseSolution) -> Evidence:
    """Of a solution from poses alone."""
    covariance = solution.covariance[:6, :6]
    robot_rad, robot_m = (float(sigma) for sigma in solution.sigmas[:2])
    distances, used = poses.distances_m, solution.used
    lever = _lever(poses.mounting, solution.X, solution.Y, np.zeros(3), _mean(distances[used]))
    return Evidence(
        mounting=poses.mounting,
        names=names,
        T_base_flange=poses.T_base_flange,
        T_camera_board=poses.T_camera_board,
        used=used,
        distance_m=distances,
        X=solution.X,
        Y=solution.Y,
        covariance=covariance,
        robot_sigma_m=robot_m,
        robot_sigma_rad=robot_rad,
        left_out_m=_rms(solution.off_m[used]),
        lever_m=lever,
    )


def _lever(
    mounting: Mounting, X: NDArray[np.float64], Y: NDArray[np.float64], middle: NDArray[np.float64], distance_m: float
) -> NDArray[np.float64]:
    """(3,) from the flange to what is looked at, along the camera's axes: past the camera that it carries, or to the
    middle of what else it carries."""
    if mounting == "eye-in-hand":
        return np.array([0.0, 0.0, distance_m]) + X[:3, :3].T @ X[:3, 3]
    return np.array([0.0, 0.0, np.linalg.norm(Y[:3, :3] @ middle + Y[:3, 3])])


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.mean(values))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
