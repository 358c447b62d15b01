"""Outlier rejection: exclude views that contradict the other views, one at a time, and outlier corners.

A wrong nominal board size, for example of a print that was scaled to its page, makes near and far views inconsistent.
The effect looks like robot errors. If views are excluded, the adjustment is therefore repeated with a free board scale.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.board_pose import BoardPoses, inlier_corners
from calibration.solver.adjustment import Adjustment
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.cross_validation import CrossValidation, cross_validate
from calibration.solver.problem import Problem, Unknowns

EXCLUDE_P_VALUE = 1e-5
"""A view is excluded if the p-value of its leave-one-out error is below this limit."""
INCLUDE_P_VALUE = 1e-3
"""An excluded view is included again if the p-value of its leave-one-out error is above this limit."""
MIN_VIEWS = 4
"""Minimum number of views that are kept. Fewer views are too few to identify an outlier."""
FREE_SCALE_SIGMA = 0.05
"""Relative prior standard deviation of a free board scale, as for a board that was not measured."""
MIN_SCALE_CHANGE = 0.005
"""Minimum relative change of a free board scale. A smaller change cannot explain the excluded views."""
MIN_EXCLUDED_VIEWS = 2
"""Minimum number of excluded views for which a free board scale is tried. A single view may be a chance outlier."""


MAX_CHANGES_PER_VIEW = 2
"""Maximum number of changes of the used views, for each view: it can be excluded and included again."""


@dataclass(frozen=True, eq=False)
class ConsistentSolution:
    """Solution from the inlier views and corners, with its cross-validation."""

    adjusted: Adjustment
    """The solution."""
    cross_validation: CrossValidation
    """Cross-validation of the solution on all views, including the excluded views."""


def reject_outliers(
    problem: Problem, board_poses: BoardPoses, start: Unknowns, adjusted: Adjustment
) -> ConsistentSolution:
    """Exclude inconsistent views and outlier corners. Use a free board scale if more views are then consistent.

    Args:
        problem: The measurements and priors.
        board_poses: Board poses, each estimated from one view alone.
        start: Initial unknowns of an adjustment with a free board scale.
        adjusted: Solution from the views that the initial guess classified as inliers, with the nominal board scale.

    Returns:
        The solution with the larger number of used views. It has the nominal scale if the free scale changes little.
    """
    nominal = keep_consistent_views(problem, board_poses, adjusted)
    if int((board_poses.found & ~nominal.adjusted.used).sum()) < MIN_EXCLUDED_VIEWS:
        return nominal
    free_problem = replace(problem, priors=replace(problem.priors, scale=FREE_SCALE_SIGMA))
    free_adjusted = adjust(free_problem, start, board_poses.found, board_poses.inliers, problem.priors.noise)
    free = keep_consistent_views(free_problem, board_poses, free_adjusted)
    changed = abs(np.log(free.adjusted.board_scale)) > MIN_SCALE_CHANGE
    if changed and free.adjusted.used.sum() > nominal.adjusted.used.sum():
        return free
    return nominal


def keep_consistent_views(problem: Problem, board_poses: BoardPoses, adjusted: Adjustment) -> ConsistentSolution:
    """Exclude and include views until each used view is consistent with its prediction from the other views.

    The solution is adjusted again after each change.

    Args:
        problem: The measurements and priors.
        board_poses: Board poses, each estimated from one view alone.
        adjusted: Initial solution, adjusted with the corners `board_poses.inliers`.
    """
    inliers = _update_inliers(problem, adjusted, adjusted.inliers)
    cross_validation = cross_validate(problem, board_poses, adjusted)
    for _ in range(MAX_CHANGES_PER_VIEW * len(adjusted.used)):
        used = _update_used(adjusted.used, cross_validation.squares)
        if (used == adjusted.used).all():
            break
        # A view that was not used before starts without a robot error.
        robot_errors = np.where(used[:, None] & adjusted.used[:, None], adjusted.unknowns.robot_errors, 0.0)
        start = replace(adjusted.unknowns, robot_errors=robot_errors)
        adjusted = adjust(problem, start, used, inliers, adjusted.noise)
        cross_validation = cross_validate(problem, board_poses, adjusted)
    inliers = _update_inliers(problem, adjusted, inliers)
    if (inliers != adjusted.inliers).any():
        adjusted = adjust(problem, adjusted.unknowns, adjusted.used, inliers, adjusted.noise)
        cross_validation = cross_validate(problem, board_poses, adjusted)
    return ConsistentSolution(adjusted, cross_validation)


def _update_used(used: NDArray[np.bool_], squares: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (N,) of the views to use next, by their `CrossValidation.squares` (N,).

    Excluded views that agree with the others are included again. If none agrees, the used view with the largest value
    is excluded, if it is an outlier.
    """
    returning = ~used & (squares < _squares_limit(used, INCLUDE_P_VALUE))
    if returning.any():
        return used | returning
    # Exclude one view at a time, because a bad view also worsens the errors of good views.
    squares_of_used = np.where(used, squares, -np.inf)
    worst = int(np.argmax(squares_of_used))
    if squares_of_used[worst] > _squares_limit(used, EXCLUDE_P_VALUE) and used.sum() > MIN_VIEWS:
        used = used.copy()
        used[worst] = False
    return used


def _squares_limit(used: NDArray[np.bool_], p_value: float) -> float:
    """Return the value of `CrossValidation.squares` that a good view exceeds with the probability `p_value`."""
    from scipy.special import fdtri

    # The squares divided by 6 follow an F-distribution, because the noise is estimated from few views.
    degrees_of_freedom = 6.0 * max(int(used.sum()) - 3, 1)
    return 6.0 * float(fdtri(6, degrees_of_freedom, 1 - p_value))


def _update_inliers(problem: Problem, adjusted: Adjustment, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the inlier mask (N, M), updated with the solution for used views and unchanged for unused views."""
    fitting = inlier_corners(adjusted.unknowns.T_camera_board(problem), adjusted.unknowns.corrections, problem.corners)
    return np.where(adjusted.used[:, None], fitting, inliers)
