"""Bundle adjustment of X, Y, the robot errors, the lens and the board scale.

The cost is the sum of the squared whitened residuals: reprojection residuals, robot errors, and deviations of lens and
board scale from their priors. The noise levels are estimated along with the unknowns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import solve_stack
from calibration.solver.noise import NoiseLevel
from calibration.solver.problem import (
    N_SHARED,
    NormalEquations,
    Problem,
    Unknowns,
    build_normal_equations,
    linearise_corners,
)
from calibration.solver.variance_components import estimate_noise

MAX_STEPS = 200
"""Maximum number of damped Gauss-Newton steps, accepted or rejected. The levels of smooth errors settle slowly."""
MAX_DAMPING = 1e6
"""Damping limit. The adjustment stops if a step with this damping still increases the cost."""
COST_TOLERANCE = 1e-2
"""Increase of the cost, a chi-square, that an accepted step may cause. With a lens weight below 1, the right-hand side
is the gradient of the cost to first order only."""
STEP_TOLERANCE = 1e-3
"""Convergence limit of the step length, in standard deviations of the unknowns. The limit of the relative change of
the noise levels is ten times larger."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Solution of the bundle adjustment, with the views and corners that it uses."""

    unknowns: Unknowns
    """The solution."""
    noise: NoiseLevel
    """Noise levels: estimated, or the given levels if `NoisePriors.estimate_noise` is False."""
    used: NDArray[np.bool_]
    """(N,) mask, True for the views that the solution uses."""
    inliers: NDArray[np.bool_]
    """(N, M) mask, True for inlier corners. The solution uses the inlier corners of the used views."""
    normal_equations: NormalEquations
    """Normal equations linearised at the solution."""
    converged: bool
    """False if `MAX_STEPS` steps did not suffice, or if no step decreased the cost."""

    @property
    def shared_covariance(self) -> NDArray[np.float64]:
        """(N_SHARED + S, N_SHARED + S) covariance: unknowns in the order given at `N_SHARED`, then smooth weights."""
        return self.normal_equations.shared_covariance(self.used)

    @property
    def board_scale(self) -> float:
        """Estimated size of the board divided by its nominal size."""
        return float(np.exp(self.unknowns.corrections[4]))

    @property
    def board_scale_sigma(self) -> float:
        """Standard deviation of `board_scale`."""
        return float(np.sqrt(self.shared_covariance[N_SHARED - 1, N_SHARED - 1]))


def adjust(
    problem: Problem, start: Unknowns, used: NDArray[np.bool_], inliers: NDArray[np.bool_], noise: NoiseLevel
) -> Adjustment:
    """Solve the bundle adjustment by damped Gauss-Newton steps.

    Args:
        problem: The measurements and priors.
        start: Initial unknowns.
        used: (N,) mask of the views to use.
        inliers: (N, M) mask of the inlier corners. Corners of unused views have no effect on the solution.
        noise: Initial noise levels.
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
        if not trial_equations.cost <= equations.cost + COST_TOLERANCE:  # The cost increased or is NaN.
            damping *= 30
            if damping > MAX_DAMPING:
                return Adjustment(unknowns, noise, used, inliers, equations, converged=False)
            continue
        # A strongly damped step is short even far from the solution.
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
