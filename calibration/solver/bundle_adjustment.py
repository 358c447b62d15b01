"""The adjustment: X, the board's pose, the robot's error in every pose, the lens and the board's size, all at once.

What is made smallest is the sum of the squared reprojection errors, of the robot's errors and of what the lens and the
board differ from what was told, each in its own standard deviation; those of the noise are estimated along with it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_stack, solve_stack
from calibration.solver.noise import NoiseLevel
from calibration.solver.problem import NormalEquations, Problem, Unknowns, corner_terms, normal_equations
from calibration.solver.variance_components import estimate_noise

STEPS = 40
MOST_DAMPED = 1e6
"""Where so short a step still leads uphill, no step leads down."""
SETTLED = 1e-3
"""No unknown moves any more by this share of its standard deviation, and no noise level by ten times as much."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The solution, with the views and corners it was made of."""

    unknowns: Unknowns
    noise: NoiseLevel
    used: NDArray[np.bool_]
    """(N,)."""
    good: NDArray[np.bool_]
    """(N, M) corners that fit."""
    linearised: NormalEquations
    """Around it."""
    settled: bool
    """False: the steps ran out while it still moved, or none led on."""

    @property
    def shared_covariance(self) -> NDArray[np.float64]:
        """(SHARED, SHARED) of the errors of X, Y and the lens, in that order."""
        return invert_stack(self.linearised.shared_information(self.used))

    @property
    def board_scale(self) -> float:
        """The board's size as a share of the told one."""
        return float(np.exp(self.unknowns.lens[4]))

    @property
    def board_scale_sigma(self) -> float:
        """Its standard deviation."""
        return float(np.sqrt(self.shared_covariance[-1, -1]))


def adjust(
    problem: Problem, start: Unknowns, used: NDArray[np.bool_], good: NDArray[np.bool_], noise: NoiseLevel
) -> Adjustment:
    """The best fit to the views `used` (N,) and, of them, the corners `good` (N, M), from `start` and `noise` on."""
    unknowns = start
    system = normal_equations(problem, corner_terms(problem, unknowns, good), used, noise)
    damping = 1e-6
    for _ in range(STEPS):
        information = system.shared_information(used)
        scale = np.sqrt(np.diag(information))
        damped = information + damping * np.diag(scale**2)
        pull = system.reduced_pull[used].sum(axis=0) + system.prior_pull
        shared = solve_stack(damped, pull)
        tried = unknowns.moved(shared, np.where(used[:, None], system.errors_step(shared), 0.0))
        measured = corner_terms(problem, tried, good)
        then = normal_equations(problem, measured, used, noise)
        if not then.cost <= system.cost * (1 + 1e-9) + 1e-9:  # worse, or no number
            damping *= 30
            if damping > MOST_DAMPED:
                return Adjustment(unknowns, noise, used, good, system, settled=False)
            continue
        # A step that was held back says nothing of how far the solution is.
        still = damping < 1.0 and float(np.sqrt(shared @ information @ shared)) < SETTLED
        damping = max(damping / 10, 1e-9)
        unknowns, system = tried, then
        if problem.assumed.estimate_noise:
            former, noise = noise, estimate_noise(problem.assumed, noise, unknowns, system, used, good)
            still &= noise.is_near(former, 10 * SETTLED)
            system = normal_equations(problem, measured, used, noise)
        if still:
            return Adjustment(unknowns, noise, used, good, system, settled=True)
    return Adjustment(unknowns, noise, used, good, system, settled=False)
