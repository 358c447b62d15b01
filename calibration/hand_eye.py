"""Hand-eye calibration: from pictures of a board, and where the robot said it was, to where the camera is."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.assumed import Assumed
from calibration.board_pose import BoardPoses, board_poses
from calibration.board_size import adjust_with_size
from calibration.camera_check import check_mounting
from calibration.diagnosis import check_not_mirrored, check_together
from calibration.errors import HandEyeInputError
from calibration.gates import covariance_to_report, eight_views_to_report, gate
from calibration.hand_eye_result import HandEyeResult
from calibration.input_check import check_camera_moved, check_observations, check_poses
from calibration.normal_equations import Problem, Unknowns
from calibration.observations import Mounting, Observations
from calibration.pose_solution import Poses, solve_weighted
from calibration.pose_stack import inverses
from calibration.repeated_poses import stand_ins, stand_ins_of_poses, with_repeated
from calibration.reprojection import LENS, camera_matrix, corners_of
from calibration.robust_start import robust_start
from calibration.solved_evidence import picture_evidence, pose_evidence
from calibration.view_reports import pose_reports, view_reports

FEWEST_POSES = 3
"""Views without which there is no solution at all; the gates ask for more."""


def solve_hand_eye(observations: Observations, assumed: Assumed | None = None) -> HandEyeResult:
    """Where the camera is on the flange (or in the cell), how surely, and whether to use it: see `verdict`.

    Of several pictures from one pose of the arm one is solved from, as `calibration.repeated_poses` says.

    Raises:
        HandEyeInputError: observations that no calibration can be solved from, by `check_observations` or because
            most views do not fit one another at all; bad ones that can be solved give a result with the verdict
            "refuse".
    """
    assumed = assumed or Assumed()
    check_observations(observations)
    given, chosen = observations.views, stand_ins(observations)
    observations = replace(observations, views=tuple(view for k, view in enumerate(given) if k == chosen[k]))
    T_base_flange = np.array([view.T_base_flange for view in observations.views], dtype=np.float64)
    problem = Problem(corners_of(observations), T_base_flange, observations.mounting, assumed)
    alone = board_poses(problem.corners)
    start, agreeing = _start(problem, alone, tuple(view.name for view in observations.views))
    adjusted, left_out = adjust_with_size(problem, alone, start, agreeing)
    evidence = picture_evidence(observations, problem, alone, adjusted, left_out)
    return HandEyeResult(
        mounting=observations.mounting,
        X=evidence.X,
        covariance=covariance_to_report(evidence),
        Y=evidence.Y,
        K=camera_matrix(observations.K, adjusted.unknowns.lens),
        board_scale=adjusted.board_scale,
        board_scale_sigma=adjusted.board_scale_sigma,
        pixel_sigma_px=adjusted.noise.pixel_px,
        robot_sigma_m=evidence.robot_sigma_m,
        robot_sigma_rad=evidence.robot_sigma_rad,
        left_out_m=evidence.left_out_m,
        eight_views_m=eight_views_to_report(evidence),
        views=with_repeated(
            view_reports(evidence.names, problem, alone, adjusted, left_out),
            tuple(view.name for view in given),
            chosen,
            tuple(len(view.ids) for view in given),
        ),
        findings=gate(evidence),
        joint_covariance=adjusted.shared_covariance,
    )


def solve_poses(
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting = "eye-in-hand",
    names: tuple[str, ...] | None = None,
    assumed: Assumed | None = None,
) -> HandEyeResult:
    """The same from poses (N, 4, 4) alone, where the pictures are not at hand or no pictures of a board of ours.

    What only pictures tell stays as it was: `K` is the identity, the board's scale 1 +- 0, the pixels' noise 0.

    Raises:
        HandEyeInputError: poses that no calibration can be solved from, by `check_poses` and `check_mounting`.
    """
    assumed = assumed or Assumed()
    check_mounting(mounting)
    check_poses(T_base_flange, T_camera_board, names)
    T_base_flange, T_camera_board = np.asarray(T_base_flange, np.float64), np.asarray(T_camera_board, np.float64)
    given = names or tuple(str(k) for k in range(len(T_base_flange)))
    chosen = stand_ins_of_poses(T_base_flange, T_camera_board)
    different = np.unique(chosen)
    poses = Poses(T_base_flange[different], T_camera_board[different], mounting)
    names = tuple(given[k] for k in different)
    start = robust_start(poses.A, poses.T_camera_board, None, assumed.robot_m, assumed.robot_rad)
    solution = solve_weighted(poses, start.X, start.Y, assumed)
    evidence = pose_evidence(names, poses, solution)
    return HandEyeResult(
        mounting=mounting,
        X=evidence.X,
        covariance=covariance_to_report(evidence),
        Y=evidence.Y,
        K=np.eye(3),
        board_scale=1.0,
        board_scale_sigma=0.0,
        pixel_sigma_px=0.0,
        robot_sigma_m=evidence.robot_sigma_m,
        robot_sigma_rad=evidence.robot_sigma_rad,
        left_out_m=evidence.left_out_m,
        eight_views_m=eight_views_to_report(evidence),
        views=with_repeated(pose_reports(names, poses, solution), given, chosen, (0,) * len(given)),
        findings=gate(evidence),
        joint_covariance=solution.covariance,
    )


def _start(problem: Problem, alone: BoardPoses, names: tuple[str, ...]) -> tuple[Unknowns, NDArray[np.bool_]]:
    """Rough X and Y, and the views (N,) that agree with them."""
    found = alone.found
    if found.sum() < FEWEST_POSES:
        raise HandEyeInputError(
            "too-few-corners",
            f"in {found.sum()} of {len(found)} views the corners lie as on the board, and more are needed: check that "
            "it is this board, flat, sharp and not mirrored, and that the camera matrix is of these pictures",
        )
    check_not_mirrored(alone.T_camera_board[found])
    check_camera_moved(alone.T_camera_board[found])
    flange = problem.T_base_flange[found]
    start = robust_start(
        flange if problem.mounting == "eye-in-hand" else inverses(flange),
        alone.T_camera_board[found],
        problem.corners.middle,
        problem.assumed.robot_m,
        problem.assumed.robot_rad,
    )
    check_together(
        start, flange, alone.T_camera_board[found], problem.mounting, tuple(names[k] for k in np.flatnonzero(found))
    )
    agreeing = np.zeros(len(found), dtype=bool)
    agreeing[found] = start.inliers
    return Unknowns(start.X, start.Y, np.zeros((len(found), 6)), np.zeros(LENS)), agreeing
