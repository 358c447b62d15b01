"""Systematic errors: adjust the consistent views again, with smooth robot errors and a cautious lens."""

from dataclasses import replace

import numpy as np

from calibration.pose_estimation.board_pose import BoardPoses
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.corner_patterns import lens_information_weight
from calibration.solver.cross_validation import cross_validate
from calibration.solver.outlier_rejection import FREE_SCALE_SIGMA, ConsistentSolution
from calibration.solver.problem import Problem

MAX_SCALE_SIGMAS = 4.0
"""Deviation of a free board scale from 1, in standard deviations of estimate and prior, beyond which the given size is
not believed. Between the two sizes, a compromise would be wrong in any case."""


def model_systematic_errors(
    problem: Problem, board_poses: BoardPoses, solution: ConsistentSolution
) -> tuple[Problem, ConsistentSolution]:
    """Adjust the consistent views again with a model of systematic errors.

    Args:
        problem: The measurements and priors, without smooth errors.
        board_poses: Board poses, each estimated from one view alone.
        solution: Solution with its consistent views and inlier corners, without smooth errors.

    Returns:
        The problem with smooth errors, and its solution from the same views and corners.
    """
    weight = lens_information_weight(problem, solution.adjusted)
    problem = replace(problem, has_smooth_errors=True, lens_weight=weight)
    free_problem = replace(problem, priors=replace(problem.priors, scale=FREE_SCALE_SIGMA))
    initial = problem.priors.noise
    noise = replace(solution.adjusted.noise, smooth_m=initial.smooth_m, smooth_rad=initial.smooth_rad)
    n_smooth = problem.smooth_modes.shape[2]
    start = replace(solution.adjusted.unknowns, smooth_weights=np.zeros(n_smooth))
    used = solution.adjusted.used
    inliers = solution.adjusted.inliers
    free = adjust(free_problem, start, used, inliers, noise)
    limit = MAX_SCALE_SIGMAS * np.hypot(free.board_scale_sigma, problem.priors.scale)
    if abs(np.log(free.board_scale)) > limit:
        return free_problem, ConsistentSolution(free, cross_validate(free_problem, board_poses, free))
    adjusted = adjust(problem, free.unknowns, used, inliers, free.noise)
    return problem, ConsistentSolution(adjusted, cross_validate(problem, board_poses, adjusted))
