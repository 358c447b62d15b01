"""Hand-eye calibration: estimate the camera pose from images of a board and the flange poses that the robot reports."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.acceptance import acceptance_findings, reported_covariance, reported_repeatability
from calibration.assessment.diagnosis import check_consistent_start, check_not_mirrored
from calibration.assessment.evidence import collect_evidence
from calibration.assessment.view_reports import report_views
from calibration.errors import HandEyeInputError
from calibration.input_checks.observations import check_camera_moved, check_observations
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import BoardPoses, estimate_board_poses
from calibration.pose_estimation.duplicate_poses import add_duplicate_reports, choose_representatives
from calibration.pose_estimation.projection import N_CORRECTIONS, stack_corners
from calibration.result import HandEyeResult
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.initialisation import equation_poses, estimate_initial_guess
from calibration.solver.noise import NoisePriors
from calibration.solver.outlier_rejection import reject_outliers
from calibration.solver.problem import N_SHARED, Problem, Unknowns
from calibration.solver.systematic_errors import model_systematic_errors

MIN_BOARD_POSES = 3
"""Minimum number of views with a board pose. Fewer views do not determine X. The acceptance limits are stricter."""


def solve_hand_eye(observations: Observations, priors: NoisePriors | None = None) -> HandEyeResult:
    """Estimate the camera pose on the flange (eye-in-hand) or in the cell (eye-to-hand) from board corners.

    `observations.mounting` selects the case. Images taken at the same arm pose count as one view. Views that
    contradict the other views are excluded; `views` of the result gives the reasons.

    Args:
        observations: Board, camera, and at least eight views (better fifteen). Tilt the camera by 20 to 30 degrees in
            all directions, roll it about its optical axis, and use two distances.
        priors: Standard deviations of the noise and the priors. None: the defaults of `NoisePriors`.

    Returns:
        The calibration with its covariance, its views and its verdict. Read `verdict` and `findings` before you use
        it: observations of bad quality give a result with the verdict `"refuse"`.

    Raises:
        HandEyeInputError: The observations do not determine a calibration. `slug` names the failed check.

    Example:
        >>> import numpy as np
        >>> from calibration.target import Board
        >>> from calibration.observations import BoardView, Observations
        >>> from calibration.geometry import from_rotation_vector, inverse, transform_points
        >>> board = Board()
        >>> K = np.array([[805.0, 0, 639.5], [0, 805.0, 399.5], [0, 0, 1]])
        >>> T_flange_camera = from_rotation_vector(translation=(0.03, -0.06, 0.05), rotation_vector=(0.1, 0.05, 0.4))
        >>> T_base_board = from_rotation_vector(translation=(0.4, 0.1, 0.0), rotation_vector=(np.pi, 0.0, 0.0))
        >>> views = []  # synthetic views without noise
        >>> for k in range(15):
        ...     azimuth = np.radians(24 * k)
        ...     tilt = np.radians((20, 30)[k % 2])
        ...     roll = (0.4, -1.3, -0.4, 1.3)[k % 4]
        ...     distance = (0.34, 0.46)[k // 2 % 2]
        ...     tilt_axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        ...     T_board_camera = (
        ...         from_rotation_vector(translation=board.points.mean(axis=0), rotation_vector=tilt * tilt_axis)
        ...         @ from_rotation_vector(translation=(0, 0, 0), rotation_vector=(0, 0, roll))
        ...         @ from_rotation_vector(translation=(0, 0, -distance), rotation_vector=(0, 0, 0))
        ...     )
        ...     T_base_flange = T_base_board @ T_board_camera @ inverse(T_flange_camera)
        ...     u, v, w = K @ transform_points(inverse(T_board_camera), board.points).T
        ...     pixels = np.column_stack([u / w, v / w])
        ...     views.append(BoardView(f"{k:02}", T_base_flange, np.arange(len(pixels)), pixels))
        >>> result = solve_hand_eye(Observations(board, K, (1280, 800), tuple(views)))
        >>> result.verdict
        'accept'
        >>> bool(np.abs(result.X - T_flange_camera).max() < 1e-6)
        True
    """
    check_observations(observations)
    representatives = choose_representatives(observations)
    # The solver needs one view per robot pose.
    distinct = replace(observations, views=tuple(observations.views[k] for k in np.unique(representatives)))
    problem = Problem(stack_corners(distinct), distinct.T_base_flange, distinct.mounting, priors or NoisePriors())
    board_poses = _estimate_board_poses(problem)
    start, used = _initialise(problem, board_poses, tuple(view.name for view in distinct.views))
    adjusted = adjust(problem, start, used, board_poses.inliers, problem.priors.noise)
    solution = reject_outliers(problem, board_poses, start, adjusted)
    problem, solution = model_systematic_errors(problem, board_poses, solution)
    evidence = collect_evidence(distinct, problem, board_poses, solution)
    reports = report_views(evidence.names, problem, board_poses, solution)
    return HandEyeResult(
        mounting=evidence.mounting,
        X=evidence.X,
        covariance=reported_covariance(evidence),
        Y=evidence.Y,
        K=evidence.K,
        board_scale=evidence.board_scale,
        board_scale_sigma=evidence.board_scale_sigma,
        pixel_sigma_px=evidence.pixel_sigma_px,
        robot_sigma_m=evidence.robot_sigma_m,
        robot_sigma_rad=evidence.robot_sigma_rad,
        loo_error_m=evidence.loo_error_m,
        repeatability_95_m=reported_repeatability(evidence),
        views=add_duplicate_reports(reports, observations, representatives),
        findings=acceptance_findings(evidence),
        joint_covariance=solution.adjusted.shared_covariance[:N_SHARED, :N_SHARED],
    )


def _estimate_board_poses(problem: Problem) -> BoardPoses:
    """Estimate one board pose per view, and check that enough are found, not mirrored, and different in rotation."""
    board_poses = estimate_board_poses(problem.corners)
    found = board_poses.found
    if found.sum() < MIN_BOARD_POSES:
        raise HandEyeInputError(
            "too-few-corners",
            f"in {found.sum()} of {len(found)} views the corners fit the board, and {MIN_BOARD_POSES} such views are "
            "needed: check that it is the given board, flat, sharp and not mirrored, and that the camera matrix "
            "belongs to these images",
        )
    check_not_mirrored(board_poses.T_camera_board[found])
    check_camera_moved(board_poses.T_camera_board[found])
    return board_poses


def _initialise(
    problem: Problem, board_poses: BoardPoses, names: tuple[str, ...]
) -> tuple[Unknowns, NDArray[np.bool_]]:
    """Return initial unknowns (X and Y by RANSAC, all other unknowns zero) and the mask (N,) of inlier views."""
    found = board_poses.found
    T_base_flange = problem.T_base_flange[found]
    T_camera_board = board_poses.T_camera_board[found]
    guess = estimate_initial_guess(
        equation_poses(T_base_flange, problem.mounting),
        T_camera_board,
        problem.corners.middle,
        problem.priors.robot_m,
        problem.priors.robot_rad,
    )
    names_found = tuple(names[k] for k in np.flatnonzero(found))
    check_consistent_start(guess, T_base_flange, T_camera_board, problem.mounting, names_found)
    used = np.zeros(len(found), dtype=bool)
    used[found] = guess.inliers
    start = Unknowns(
        X=guess.X,
        Y=guess.Y,
        robot_errors=np.zeros((len(found), 6)),
        corrections=np.zeros(N_CORRECTIONS),
    )
    return start, used
