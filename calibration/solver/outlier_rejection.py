"""Which views agree: adjusted with some, each is compared with what the others predict, until none changes sides."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.board_pose import BoardPoses, inlier_corners
from calibration.solver.bundle_adjustment import Adjustment, adjust
from calibration.solver.cross_validation import CrossValidation, cross_validate
from calibration.solver.problem import Problem, Unknowns

LEAVES = 1e-5
"""A view is left out that is as far off by chance less often than this ..."""
RETURNS = 1e-3
"""... and taken back when it is not rarer than this."""
FEWEST = 4
"""No more are left out than leave so many: fewer agree with anything."""


def adjust_and_reject(
    problem: Problem, alone: BoardPoses, start: Unknowns, used: NDArray[np.bool_]
) -> tuple[Adjustment, CrossValidation]:
    """The adjustment of those views that agree, from `start` and the views `used` (N,) on, and all views against it."""
    good = alone.good
    adjusted = adjust(problem, start, used, good, problem.assumed.noise)
    good = _better_corners(problem, adjusted, good)
    left_out = cross_validate(problem, alone, adjusted)
    for _ in range(2 * len(used)):
        used = _next(adjusted.used, left_out.squares, rejection_limits(adjusted))
        if (used == adjusted.used).all():
            break
        errors = np.where(used[:, None] & adjusted.used[:, None], adjusted.unknowns.errors, 0.0)
        adjusted = adjust(problem, replace(adjusted.unknowns, errors=errors), used, good, adjusted.noise)
        left_out = cross_validate(problem, alone, adjusted)
    final = _better_corners(problem, adjusted, good)
    if (final != adjusted.good).any():
        adjusted = adjust(problem, adjusted.unknowns, adjusted.used, final, adjusted.noise)
        left_out = cross_validate(problem, alone, adjusted)
    return adjusted, left_out


def rejection_limits(adjusted: Adjustment) -> tuple[float, float]:
    """Squares in standard deviations from which on a view leaves, and below which it returns."""
    from scipy.special import fdtri

    # The noise is estimated from the same few views: Snedecor's distribution, not the normal one.
    errors = 6.0 * max(int(adjusted.used.sum()) - 3, 1)
    return 6.0 * float(fdtri(6, errors, 1 - LEAVES)), 6.0 * float(fdtri(6, errors, 1 - RETURNS))


def _next(used: NDArray[np.bool_], squares: NDArray[np.float64], limit: tuple[float, float]) -> NDArray[np.bool_]:
    returning = ~used & (squares < limit[1])
    if returning.any():
        return used | returning
    # One at a time: a bad view makes good ones look bad.
    inside = np.where(used, squares, -np.inf)
    worst = int(np.argmax(inside))
    if inside[worst] > limit[0] and used.sum() > FEWEST:
        used = used.copy()
        used[worst] = False
    return used


def _better_corners(problem: Problem, adjusted: Adjustment, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N, M) in the views used the corners that fit the solution, in the others those that fit their own pose."""
    fitting = inlier_corners(adjusted.unknowns.T_camera_board(problem), adjusted.unknowns.lens, problem.corners)
    return np.where(adjusted.used[:, None], fitting, good)
