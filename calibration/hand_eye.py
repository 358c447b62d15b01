"""Hand-eye calibration: the pose of the camera from images of a board and the reported poses of the robot."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.acceptance import acceptance_findings, reported_covariance, reported_repeatability
from calibration.assessment.diagnosis import check_not_mirrored, check_together
from calibration.assessment.evidence import collect_evidence
from calibration.assessment.view_reports import report_views
from calibration.errors import HandEyeInputError
from calibration.geometry.se3 import invert_poses
from calibration.input_checks.observations import check_camera_moved, check_observations
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import BoardPoses, estimate_board_poses
from calibration.pose_estimation.duplicate_poses import add_duplicate_reports, choose_representatives
from calibration.pose_estimation.projection import N_LENS, camera_matrix, stack_corners
from calibration.result import HandEyeResult
from calibration.solver.bundle_adjustment import Adjustment, adjust
from calibration.solver.cross_validation import CrossValidation, cross_validate
from calibration.solver.initialisation import estimate_initial_guess
from calibration.solver.noise import NoisePriors
from calibration.solver.outlier_rejection import reject_outliers
from calibration.solver.problem import Problem, Unknowns

MIN_BOARD_POSES = 3
"""Number of views with a board pose without which there is no solution. The acceptance limits ask for more."""


@dataclass(frozen=True, eq=False)
class _SolverInput:
    """The views that the solver takes: one for each pose of the arm."""

    observations: Observations
    """The observations, with the chosen views only."""
    problem: Problem
    """The same as arrays, with the priors."""
    chosen: NDArray[np.int64]
    """(G,) for each of the G given views, the number of the view that was chosen for its pose of the arm."""


@dataclass(frozen=True, eq=False)
class _Start:
    """A rough solution."""

    unknowns: Unknowns
    """Rough X and Y, without robot errors and without corrections of the lens."""
    used: NDArray[np.bool_]
    """(N,) views that agree with it."""


def solve_hand_eye(observations: Observations, priors: NoisePriors | None = None) -> HandEyeResult:
    """Solve the pose of the camera on the flange, or in the cell, from corners of a board.

    Several images from one pose of the arm count once. Views that do not fit the others are excluded and named in
    `views` of the result.

    Args:
        observations: The board, the camera, and at least eight views; fifteen are better. Tilt them by 20 to 30 degrees
            in all directions, roll them, and use two distances.
        priors: Standard deviations of the noise and the priors. None: the defaults of `NoisePriors`.

    Returns:
        The calibration with its covariance, its views and its verdict. Read `verdict` and `findings` before you use
        it: observations of bad quality give a result with the verdict `"refuse"`.

    Raises:
        HandEyeInputError: No calibration can be solved from the observations. `slug` says which check failed.

    Example:
        >>> import numpy as np
        >>> from calibration.target import Board
        >>> from calibration.observations import BoardView, Observations
        >>> from calibration.geometry import from_rotation_vector, inverse, transform_points
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
    check_observations(observations)
    given = _choose_views(observations, priors or NoisePriors())
    problem = given.problem
    board_poses = _estimate_board_poses(problem)
    start = _initialise(given, board_poses)
    adjusted = adjust(problem, start.unknowns, start.used, board_poses.inliers, problem.priors.noise)
    adjusted = reject_outliers(problem, board_poses, start.unknowns, adjusted)
    cross_validation = cross_validate(problem, board_poses, adjusted)
    return _judge(observations, given, board_poses, adjusted, cross_validation)


def _choose_views(observations: Observations, priors: NoisePriors) -> _SolverInput:
    """Choose one view for each pose of the arm, and stack the views as arrays."""
    chosen = choose_representatives(observations)
    views = tuple(view for k, view in enumerate(observations.views) if k == chosen[k])
    observations = replace(observations, views=views)
    T_base_flange = np.array([view.T_base_flange for view in views], dtype=np.float64)
    problem = Problem(stack_corners(observations), T_base_flange, observations.mounting, priors)
    return _SolverInput(observations, problem, chosen)


def _estimate_board_poses(problem: Problem) -> BoardPoses:
    """Estimate the board pose of each view by itself, and check that the poses are consistent with a moving camera."""
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


def _initialise(given: _SolverInput, board_poses: BoardPoses) -> _Start:
    """Find rough X and Y, and the views that agree with them."""
    problem, found = given.problem, board_poses.found
    T_base_flange, T_camera_board = problem.T_base_flange[found], board_poses.T_camera_board[found]
    guess = estimate_initial_guess(
        T_base_flange if problem.mounting == "eye-in-hand" else invert_poses(T_base_flange),
        T_camera_board,
        problem.corners.middle,
        problem.priors.robot_m,
        problem.priors.robot_rad,
    )
    names = tuple(given.observations.views[k].name for k in np.flatnonzero(found))
    check_together(guess, T_base_flange, T_camera_board, problem.mounting, names)
    used = np.zeros(len(found), dtype=bool)
    used[found] = guess.inliers
    return _Start(Unknowns(guess.X, guess.Y, np.zeros((len(found), 6)), np.zeros(N_LENS)), used)


def _judge(
    observations: Observations,
    given: _SolverInput,
    board_poses: BoardPoses,
    adjusted: Adjustment,
    cross_validation: CrossValidation,
) -> HandEyeResult:
    """Collect the evidence for the solution, and return it with its reports and findings."""
    problem = given.problem
    evidence = collect_evidence(given.observations, problem, board_poses, adjusted, cross_validation)
    views = add_duplicate_reports(
        report_views(evidence.names, problem, board_poses, adjusted, cross_validation),
        tuple(view.name for view in observations.views),
        given.chosen,
        tuple(len(view.ids) for view in observations.views),
    )
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
        loo_error_m=evidence.loo_error_m,
        repeatability_95_m=reported_repeatability(evidence),
        views=views,
        findings=acceptance_findings(evidence),
        joint_covariance=adjusted.shared_covariance,
    )
