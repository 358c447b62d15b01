"""Outlier rejection: excludes views that the other views contradict, one at a time, and corners that do not fit.

A board whose size differs from the given one, such as a print that was fitted to its page, makes near and far views
disagree, as if the robot had erred. If views are excluded, the adjustment is therefore tried with a free scale too.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.board_pose import BoardPoses, inlier_corners
from calibration.solver.bundle_adjustment import Adjustment, adjust
from calibration.solver.cross_validation import CrossValidation, cross_validate
from calibration.solver.problem import Problem, Unknowns

EXCLUDE_P_VALUE = 1e-5
"""A view is excluded if the p-value of its difference from the prediction is below this."""
INCLUDE_P_VALUE = 1e-3
"""An excluded view is included again if this p-value is above this."""
MIN_VIEWS = 4
"""Minimum number of views that are kept. Fewer agree with anything."""
FREE_SCALE_SIGMA = 0.05
"""Prior standard deviation of the scale of a board that nobody has measured, as a share."""
MIN_SCALE_CHANGE = 0.005
"""Change of the scale, as a share, that can explain excluded views. A smaller one excludes no view."""
MIN_EXCLUDED_VIEWS = 2
"""Number of excluded views from which a free scale is tried. One may be a chance outlier."""


@dataclass(frozen=True, eq=False)
class ConsistentSolution:
    """The solution from the views and corners that agree."""

    adjusted: Adjustment
    """The solution."""
    cross_validation: CrossValidation
    """Its cross-validation, with all views."""


def reject_outliers(
    problem: Problem, board_poses: BoardPoses, start: Unknowns, adjusted: Adjustment
) -> ConsistentSolution:
    """Exclude the views and corners that do not fit; free the scale of the board if that lets more views agree.

    Args:
        problem: The measurements and priors.
        board_poses: The board pose of each view by itself.
        start: Unknowns at which an adjustment with a free scale starts.
        adjusted: The solution from the views that agreed with `start`.
    """
    nominal = keep_consistent_views(problem, board_poses, adjusted)
    if int((board_poses.found & ~nominal.adjusted.used).sum()) < MIN_EXCLUDED_VIEWS:
        return nominal
    free_problem = replace(problem, priors=replace(problem.priors, scale=FREE_SCALE_SIGMA))
    free_adjusted = adjust(free_problem, start, board_poses.found, board_poses.inliers, problem.priors.noise)
    free = keep_consistent_views(free_problem, board_poses, free_adjusted)
    changed = abs(np.log(free.adjusted.board_scale)) > MIN_SCALE_CHANGE
    return free if changed and free.adjusted.used.sum() > nominal.adjusted.used.sum() else nominal


def keep_consistent_views(problem: Problem, board_poses: BoardPoses, adjusted: Adjustment) -> ConsistentSolution:
    """Exclude and include views, adjusting each time, until all views used agree with their prediction by the others.

    Args:
        problem: The measurements and priors.
        board_poses: The board pose of each view by itself.
        adjusted: The solution to start from, with the corners that fit the board poses.
    """
    inliers = _update_inliers(problem, adjusted, adjusted.inliers)
    cross_validation = cross_validate(problem, board_poses, adjusted)
    for _ in range(2 * len(adjusted.used)):
        used = _update_used(adjusted.used, cross_validation.squares, *_rejection_limits(adjusted))
        if (used == adjusted.used).all():
            break
        robot_errors = np.where(used[:, None] & adjusted.used[:, None], adjusted.unknowns.robot_errors, 0.0)
        start = replace(adjusted.unknowns, robot_errors=robot_errors)
        adjusted = adjust(problem, start, used, inliers, adjusted.noise)
        cross_validation = cross_validate(problem, board_poses, adjusted)
    inliers = _update_inliers(problem, adjusted, inliers)
    if (inliers != adjusted.inliers).any():
        adjusted = adjust(problem, adjusted.unknowns, adjusted.used, inliers, adjusted.noise)
        cross_validation = cross_validate(problem, board_poses, adjusted)
    return ConsistentSolution(adjusted, cross_validation)


def _rejection_limits(adjusted: Adjustment) -> tuple[float, float]:
    """Return the squared difference above which a view is excluded, and that below which it is included again."""
    from scipy.special import fdtri

    # The noise is estimated from the same few views, which makes it an F-distribution.
    errors = 6.0 * max(int(adjusted.used.sum()) - 3, 1)
    return 6.0 * float(fdtri(6, errors, 1 - EXCLUDE_P_VALUE)), 6.0 * float(fdtri(6, errors, 1 - INCLUDE_P_VALUE))


def _update_used(
    used: NDArray[np.bool_], squares: NDArray[np.float64], exclude_above: float, include_below: float
) -> NDArray[np.bool_]:
    """Return the views (N,) to use next: those that fit again are included; otherwise the worst one is excluded."""
    returning = ~used & (squares < include_below)
    if returning.any():
        return used | returning
    # One at a time: a bad view makes good ones look bad.
    squares_of_used = np.where(used, squares, -np.inf)
    worst = int(np.argmax(squares_of_used))
    if squares_of_used[worst] > exclude_above and used.sum() > MIN_VIEWS:
        used = used.copy()
        used[worst] = False
    return used


def _update_inliers(problem: Problem, adjusted: Adjustment, inliers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N, M) the corners that fit the solution in the views used, and `inliers` in the others."""
    fitting = inlier_corners(adjusted.unknowns.T_camera_board(problem), adjusted.unknowns.lens, problem.corners)
    return np.where(adjusted.used[:, None], fitting, inliers)
