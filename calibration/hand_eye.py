"""Hand-eye calibration: the pose of the camera from pictures of a board and the reported poses of the robot."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.acceptance import acceptance_findings, reported_covariance, reported_repeatability
from calibration.assessment.diagnosis import check_not_mirrored, check_together
from calibration.assessment.solved_evidence import collect_evidence, pose_evidence
from calibration.assessment.view_reports import pose_reports, report_views
from calibration.errors import HandEyeInputError
from calibration.geometry.se3 import invert_poses
from calibration.input_checks.camera import check_mounting
from calibration.input_checks.observations import check_camera_moved, check_observations, check_poses
from calibration.observations import Mounting, Observations
from calibration.pose_estimation.board_pose import BoardPoses, estimate_board_poses
from calibration.pose_estimation.duplicate_poses import add_duplicate_reports, find_duplicates, stand_ins_of_poses
from calibration.pose_estimation.projection import LENS, camera_matrix, stack_corners
from calibration.result import HandEyeResult
from calibration.solver.board_size import adjust_with_size
from calibration.solver.initialisation import estimate_initial_guess
from calibration.solver.noise import NoisePriors
from calibration.solver.pose_solution import Poses, solve_weighted
from calibration.solver.problem import Problem, Unknowns

FEWEST_POSES = 3
"""Views without which there is no solution at all; the gates ask for more."""


def solve_hand_eye(observations: Observations, assumed: NoisePriors | None = None) -> HandEyeResult:
    """Solve the pose of the camera on the flange, or in the cell, from corners of a board.

    Several pictures from one pose of the arm count once. Views that do not fit the others are excluded and named in
    `views` of the result.

    Args:
        observations: The board, the camera, and at least eight views, better fifteen. Tilt them by 20 to 30 degrees in
            all directions, roll them, and use two distances.
        assumed: Standard deviations of the noise and the priors. None: those of a usual cell.

    Returns:
        The calibration with its covariance, its views and its verdict. Read `verdict` and `findings` before you use
        it: observations of bad quality give a result with the verdict `"refuse"`.

    Raises:
        HandEyeInputError: No calibration can be solved from the observations. `slug` says which check failed.

    Example:
        >>> import numpy as np
        >>> from calibration.target.board import Board
        >>> from calibration.observations import BoardView, Observations
        >>> from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
        >>> board, K = Board(), np.array([[805.0, 0, 639.5], [0, 805.0, 399.5], [0, 0, 1]])
        >>> T_flange_camera = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
        >>> T_base_board = from_rotation_vector((0.4, 0.1, 0.0), (np.pi, 0.0, 0.0))
        >>> middle = from_rotation_vector(board.points.mean(axis=0), (0.0, 0.0, 0.0))
        >>> views = []
        >>> for k in range(15):
        ...     azimuth, tilt = 2 * np.pi * k / 15, 0.3 + 0.2 * (k % 2)
        ...     lean = from_rotation_vector((0, 0, 0), (tilt * np.cos(azimuth), tilt * np.sin(azimuth), 0))
        ...     roll = from_rotation_vector((0, 0, 0), (0, 0, (0.4, -1.3, -0.4, 1.3)[k % 4]))
        ...     away = from_rotation_vector((0, 0, -(0.34, 0.46)[k // 2 % 2]), (0, 0, 0))
        ...     T_board_camera = middle @ lean @ roll @ away
        ...     T_base_flange = T_base_board @ T_board_camera @ inverse(T_flange_camera)
        ...     x, y, z = (K @ transform_points(inverse(T_board_camera), board.points).T)
        ...     pixels = np.column_stack([x / z, y / z])
        ...     views.append(BoardView(f"{k:02}", T_base_flange, np.arange(len(pixels)), pixels))
        >>> result = solve_hand_eye(Observations(board, K, (1280, 800), tuple(views)))
        >>> result.verdict
        'accept'
        >>> bool(np.abs(result.X - T_flange_camera).max() < 1e-6)
        True
    """
    assumed = assumed or NoisePriors()
    check_observations(observations)
    given, chosen = observations.views, find_duplicates(observations)
    observations = replace(observations, views=tuple(view for k, view in enumerate(given) if k == chosen[k]))
    T_base_flange = np.array([view.T_base_flange for view in observations.views], dtype=np.float64)
    problem = Problem(stack_corners(observations), T_base_flange, observations.mounting, assumed)
    alone = estimate_board_poses(problem.corners)
    start, agreeing = _start(problem, alone, tuple(view.name for view in observations.views))
    adjusted, left_out = adjust_with_size(problem, alone, start, agreeing)
    evidence = collect_evidence(observations, problem, alone, adjusted, left_out)
    return HandEyeResult(
        mounting=observations.mounting,
        X=evidence.X,
        covariance=reported_covariance(evidence),
        Y=evidence.Y,
        K=camera_matrix(observations.K, adjusted.unknowns.lens),
        board_scale=adjusted.board_scale,
        board_scale_sigma=adjusted.board_scale_sigma,
        pixel_sigma_px=adjusted.noise.pixel_px,
        robot_sigma_m=evidence.robot_sigma_m,
        robot_sigma_rad=evidence.robot_sigma_rad,
        left_out_m=evidence.left_out_m,
        eight_views_m=reported_repeatability(evidence),
        views=add_duplicate_reports(
            report_views(evidence.names, problem, alone, adjusted, left_out),
            tuple(view.name for view in given),
            chosen,
            tuple(len(view.ids) for view in given),
        ),
        findings=acceptance_findings(evidence),
        joint_covariance=adjusted.shared_covariance,
    )


def solve_poses(
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting = "eye-in-hand",
    names: tuple[str, ...] | None = None,
    assumed: NoisePriors | None = None,
) -> HandEyeResult:
    """Solve the pose of the camera from poses of the flange and of a board, without corners.

    Args:
        T_base_flange: (N, 4, 4) flange poses that the robot reported, at rest.
        T_camera_board: (N, 4, 4) board poses in the camera frame, of the same views.
        mounting: Whether the camera is on the flange or stands in the cell.
        names: Names of the views for messages. None: their numbers.
        assumed: Standard deviations of the noise and the priors. None: those of a usual cell.

    Returns:
        The calibration. What only corners can give has no value: `K` is the identity, the scale of the board is 1 with
        sigma 0, and the noise of the pixels is 0.

    Raises:
        HandEyeInputError: No calibration can be solved from the poses. `slug` says which check failed.
    """
    assumed = assumed or NoisePriors()
    check_mounting(mounting)
    check_poses(T_base_flange, T_camera_board, names)
    T_base_flange, T_camera_board = np.asarray(T_base_flange, np.float64), np.asarray(T_camera_board, np.float64)
    given = names or tuple(str(k) for k in range(len(T_base_flange)))
    chosen = stand_ins_of_poses(T_base_flange, T_camera_board)
    different = np.unique(chosen)
    poses = Poses(T_base_flange[different], T_camera_board[different], mounting)
    names = tuple(given[k] for k in different)
    start = estimate_initial_guess(poses.A, poses.T_camera_board, None, assumed.robot_m, assumed.robot_rad)
    solution = solve_weighted(poses, start.X, start.Y, assumed)
    evidence = pose_evidence(names, poses, solution)
    return HandEyeResult(
        mounting=mounting,
        X=evidence.X,
        covariance=reported_covariance(evidence),
        Y=evidence.Y,
        K=np.eye(3),
        board_scale=1.0,
        board_scale_sigma=0.0,
        pixel_sigma_px=0.0,
        robot_sigma_m=evidence.robot_sigma_m,
        robot_sigma_rad=evidence.robot_sigma_rad,
        left_out_m=evidence.left_out_m,
        eight_views_m=reported_repeatability(evidence),
        views=add_duplicate_reports(pose_reports(names, poses, solution), given, chosen, (0,) * len(given)),
        findings=acceptance_findings(evidence),
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
    start = estimate_initial_guess(
        flange if problem.mounting == "eye-in-hand" else invert_poses(flange),
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
