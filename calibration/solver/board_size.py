"""A board that is not as large as told, as prints are that were fitted to their page.

With its size held near the told one the views near by and those far off do not agree, and some of them are left out as
if the arm had erred. With its size left free they do.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.board_pose import BoardPoses
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.cross_validation import CrossValidation
from calibration.solver.outlier_rejection import adjust_and_reject
from calibration.solver.problem import Problem, Unknowns

FREE = 0.05
"""Standard deviation of a size that nobody has measured."""
LEAST_CHANGE = 0.005
"""A size that differs by less is none that leaves views out."""
FEWEST_LEFT_OUT = 2
"""One view that is left out is an accident."""


def adjust_with_size(
    problem: Problem, alone: BoardPoses, start: Unknowns, used: NDArray[np.bool_]
) -> tuple[Adjustment, CrossValidation]:
    """As `adjust_and_reject`; with the board's size left free where views were left out that agree by another size."""
    told = adjust_and_reject(problem, alone, start, used)
    agreeing = told[0].used
    if int((alone.found & ~agreeing).sum()) < FEWEST_LEFT_OUT:
        return told
    loose = replace(problem, assumed=replace(problem.assumed, scale=FREE))
    free = adjust_and_reject(loose, alone, start, alone.found)
    changed = abs(np.log(free[0].board_scale)) > LEAST_CHANGE
    return free if changed and free[0].used.sum() > agreeing.sum() else told
