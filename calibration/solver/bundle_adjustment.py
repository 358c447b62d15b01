"""Bundle adjustment of X, Y, the robot errors, the lens and the board scale.

The cost is the sum of the squared whitened residuals: reprojection residuals, robot errors, and deviations of lens and
board scale from their priors. The noise levels are estimated along with the unknowns.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import solve_stack
from calibration.solver.adjustment import Adjustment
from calibration.solver.noise import NoiseLevel
from calibration.solver.problem import Problem, Unknowns, build_normal_equations, linearise_corners
from calibration.solver.variance_components import estimate_noise

MAX_STEPS = 200
"""Maximum number of damped Gauss-Newton steps, accepted or rejected. The levels of smooth errors settle slowly."""
INITIAL_DAMPING = 1e-6
"""Damping of the first step. The initial guess is good, so nearly undamped steps are tried first."""
MIN_DAMPING = 1e-9
"""Lower limit of the damping, so that a rejected step raises it within a few steps."""
MAX_DAMPING = 1e6
"""Damping limit. The adjustment stops if a step with this damping still increases the cost."""
DAMPING_INCREASE = 30.0
"""Factor by which a rejected step increases the damping."""
DAMPING_DECREASE = 10.0
"""Factor by which an accepted step decreases the damping."""
COST_TOLERANCE = 1e-2
"""Increase of the cost, a chi-square, that an accepted step may cause. With a lens weight below 1, the right-hand side
is the gradient of the cost to first order only."""
STEP_TOLERANCE = 1e-3
"""Convergence limit of the step length, in standard deviations of the unknowns."""
NOISE_TOLERANCE = 10 * STEP_TOLERANCE
"""Convergence limit of the relative change of the noise levels."""


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
    equations = build_normal_equations(problem, linearise_corners(problem, start, inliers), used, noise)
    current = Adjustment(start, noise, used, inliers, equations, converged=False)
    damping = INITIAL_DAMPING
    for _ in range(MAX_STEPS):
        step = _damped_step(current, damping)
        corners = linearise_corners(problem, step.unknowns, inliers)
        equations = build_normal_equations(problem, corners, used, current.noise)
        if not equations.cost <= current.normal_equations.cost + COST_TOLERANCE:  # The cost increased or is NaN.
            damping *= DAMPING_INCREASE
            if damping > MAX_DAMPING:
                return current
            continue
        # A strongly damped step is short even far from the solution.
        converged = damping < 1.0 and step.length_sigmas < STEP_TOLERANCE
        damping = max(damping / DAMPING_DECREASE, MIN_DAMPING)
        current = replace(current, unknowns=step.unknowns, normal_equations=equations)
        if problem.priors.estimate_noise:
            estimated = estimate_noise(problem.priors, current)
            converged &= estimated.is_close(current.noise, NOISE_TOLERANCE)
            equations = build_normal_equations(problem, corners, used, estimated)
            current = replace(current, noise=estimated, normal_equations=equations)
        if converged:
            return replace(current, converged=True)
    return current


@dataclass(frozen=True, eq=False)
class _Step:
    """Damped Gauss-Newton step."""

    unknowns: Unknowns
    """Unknowns after the step."""
    shared: NDArray[np.float64]
    """(N_SHARED + S,) step of the shared unknowns."""
    information: NDArray[np.float64]
    """(N_SHARED + S, N_SHARED + S) information matrix of the shared unknowns, without damping."""

    @property
    def length_sigmas(self) -> float:
        """Length of the step of the shared unknowns, in standard deviations."""
        return float(np.sqrt(self.shared @ self.information @ self.shared))


def _damped_step(current: Adjustment, damping: float) -> _Step:
    """Return the step from the current unknowns. The damping is relative to the diagonal of the information matrix."""
    used = current.used
    equations = current.normal_equations
    information = equations.shared_information(used)
    scale = np.sqrt(np.diag(information))
    damped = information + damping * np.diag(scale**2)
    g = equations.g_reduced[used].sum(axis=0) + equations.g_prior
    shared = solve_stack(damped, g)
    robot_errors = np.where(used[:, None], equations.robot_error_steps(shared), 0.0)
    return _Step(current.unknowns.add_step(shared, robot_errors), shared, information)
