"""Bundle adjustment of X, the board pose, the robot errors, the lens and the scale of the board.

It minimises the sum of the squared reprojection errors, robot errors, and corrections of the lens and the board, each
in its own standard deviation. The standard deviations of the noise are estimated along with the unknowns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import solve_stack
from calibration.solver.noise import NoiseLevel
from calibration.solver.problem import (
    NormalEquations,
    Problem,
    Unknowns,
    build_normal_equations,
    linearise_corners,
)
from calibration.solver.variance_components import estimate_noise

MAX_STEPS = 40
"""Maximum number of damped Gauss-Newton steps, accepted or not."""
MAX_DAMPING = 1e6
"""Damping above which the adjustment stops: if such a short step still increases the cost, no step decreases it."""
STEP_TOLERANCE = 1e-3
"""Length of a step, in standard deviations, below which the solution has converged. For noise levels it is a relative
change of ten times this."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A solution, with the views and corners that it was solved from."""

    unknowns: Unknowns
    """The solution."""
    noise: NoiseLevel
    """Estimated noise levels."""
    used: NDArray[np.bool_]
    """(N,) views that it was solved from."""
    inliers: NDArray[np.bool_]
    """(N, M) corners that fit."""
    normal_equations: NormalEquations
    """Normal equations around the solution."""
    converged: bool
    """False if the solution still moved after the last step, or if no step decreased the cost."""

    @property
    def shared_covariance(self) -> NDArray[np.float64]:
        """(N_SHARED, N_SHARED) covariance of the errors of X, Y and the lens, in that order."""
        return self.normal_equations.shared_covariance(self.used)

    @property
    def board_scale(self) -> float:
        """Estimated size of the board, as a share of the given size."""
        return float(np.exp(self.unknowns.lens[4]))

    @property
    def board_scale_sigma(self) -> float:
        """One sigma of `board_scale`."""
        return float(np.sqrt(self.shared_covariance[-1, -1]))


def adjust(
    problem: Problem, start: Unknowns, used: NDArray[np.bool_], inliers: NDArray[np.bool_], noise: NoiseLevel
) -> Adjustment:
    """Solve the bundle adjustment by damped Gauss-Newton steps.

    Args:
        problem: The measurements and priors.
        start: Unknowns at which the steps start.
        used: (N,) views to solve from.
        inliers: (N, M) corners to solve from, in the views used.
        noise: Noise levels at which their estimation starts.
    """
    unknowns = start
    equations = build_normal_equations(problem, linearise_corners(problem, unknowns, inliers), used, noise)
    damping = 1e-6
    for _ in range(MAX_STEPS):
        information = equations.shared_information(used)
        scale = np.sqrt(np.diag(information))
        damped = information + damping * np.diag(scale**2)
        g = equations.g_reduced[used].sum(axis=0) + equations.g_prior
        shared = solve_stack(damped, g)
        trial = unknowns.add_step(shared, np.where(used[:, None], equations.robot_error_steps(shared), 0.0))
        corners = linearise_corners(problem, trial, inliers)
        trial_equations = build_normal_equations(problem, corners, used, noise)
        if not trial_equations.cost <= equations.cost * (1 + 1e-9) + 1e-9:  # larger, or not a number
            damping *= 30
            if damping > MAX_DAMPING:
                return Adjustment(unknowns, noise, used, inliers, equations, converged=False)
            continue
        # The length of a strongly damped step does not show the distance to the solution.
        converged = damping < 1.0 and float(np.sqrt(shared @ information @ shared)) < STEP_TOLERANCE
        damping = max(damping / 10, 1e-9)
        unknowns, equations = trial, trial_equations
        if problem.priors.estimate_noise:
            former, noise = noise, estimate_noise(problem.priors, noise, unknowns, equations, used, inliers)
            converged &= noise.is_close(former, 10 * STEP_TOLERANCE)
            equations = build_normal_equations(problem, corners, used, noise)
        if converged:
            return Adjustment(unknowns, noise, used, inliers, equations, converged=True)
    return Adjustment(unknowns, noise, used, inliers, equations, converged=False)
