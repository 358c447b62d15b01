"""Variance components: estimates of the corner noise and the robot noise from the errors of a solution.

Each sum of squared errors is divided by its redundancy, which is the number of its errors minus the degrees of freedom
that the unknowns use (Foerstner's estimate). Its fixed point is the restricted maximum likelihood estimate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_stack
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.problem import N_SHARED, NormalEquations, Unknowns

PRIOR_WEIGHT = 2.0
"""Number of errors that the prior level counts as, in addition to those of the views."""
MIN_NOISE = NoiseLevel(pixel_px=1e-3, robot_m=1e-6, robot_rad=2e-6)
"""Lower limits of the estimates. They keep the weights finite when the views are exact."""


@dataclass(frozen=True, eq=False)
class RobotErrorSquares:
    """Squared robot errors of N views with their redundancy: rotation (radians), then translation (metres)."""

    squares: NDArray[np.float64]
    """(N, 2) sums of squares, rad^2 and m^2; 0 for views that are not used."""
    redundancy: NDArray[np.float64]
    """(N, 2) redundancy, up to 3 each; 0 for views that are not used."""

    def sigmas(self, priors: NoisePriors, excluded: int | None = None) -> NDArray[np.float64]:
        """Return the (2,) robot noise, rad and m, from all views, or from all but the view `excluded`."""
        prior = np.array([priors.robot_rad, priors.robot_m])
        if not priors.estimate_noise:
            return prior
        rows = np.arange(len(self.squares)) != excluded
        squares = self.squares[rows].sum(axis=0) + PRIOR_WEIGHT * prior**2
        sigmas = np.sqrt(squares / (self.redundancy[rows].sum(axis=0) + PRIOR_WEIGHT))
        return np.maximum(sigmas, [MIN_NOISE.robot_rad, MIN_NOISE.robot_m])


def robot_error_squares(
    robot_errors: NDArray[np.float64],
    noise: NoiseLevel,
    equations: NormalEquations,
    shared_covariance: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> RobotErrorSquares:
    """Return the squares and the redundancy of the estimated robot errors.

    Args:
        robot_errors: (N, 6) twists, radians and metres.
        noise: Noise levels with which `equations` are weighted.
        equations: Normal equations around the solution.
        shared_covariance: (N_SHARED, N_SHARED) covariance of the shared unknowns.
        used: (N,) views that count.
    """
    J_shared = np.linalg.solve(equations.H_robot, equations.H_cross)
    covariance = invert_stack(equations.H_robot) + J_shared @ shared_covariance @ J_shared.swapaxes(1, 2)
    share = np.einsum("nii->ni", covariance) / noise.robot**2
    redundancy = np.clip(3.0 - share.reshape(-1, 2, 3).sum(axis=2), 1e-6, 3.0)
    squares = (robot_errors**2).reshape(-1, 2, 3).sum(axis=2)
    return RobotErrorSquares(np.where(used[:, None], squares, 0.0), np.where(used[:, None], redundancy, 0.0))


def estimate_noise(
    priors: NoisePriors,
    noise: NoiseLevel,
    unknowns: Unknowns,
    equations: NormalEquations,
    used: NDArray[np.bool_],
    inliers: NDArray[np.bool_],
) -> NoiseLevel:
    """Estimate the noise of the corners and of the robot.

    Args:
        priors: Prior noise levels.
        noise: Noise levels with which `equations` are weighted.
        unknowns: The present solution.
        equations: Normal equations around it.
        used: (N,) views of the solution.
        inliers: (N, M) corners of the solution.
    """
    shared_covariance = equations.shared_covariance(used)
    robot = robot_error_squares(unknowns.robot_errors, noise, equations, shared_covariance, used)
    robot_rad, robot_m = robot.sigmas(priors)
    freedom_of_priors = float(np.sum(np.diag(shared_covariance) * np.diag(equations.H_prior)))
    freedom_of_robot = 6.0 * used.sum() - float(robot.redundancy.sum())
    freedom_of_corners = 6.0 * used.sum() + N_SHARED - freedom_of_priors - freedom_of_robot
    redundancy = max(2.0 * float(inliers[used].sum()) - freedom_of_corners, 1.0)
    squares = float(equations.squares_px2[used].sum())
    pixel_px = np.sqrt((squares + PRIOR_WEIGHT * priors.pixel_px**2) / (redundancy + PRIOR_WEIGHT))
    return NoiseLevel(max(float(pixel_px), MIN_NOISE.pixel_px), float(robot_m), float(robot_rad))
