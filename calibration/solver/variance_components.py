"""Variance component estimation (Foerstner): the corner noise and the robot noise from the residuals of a solution.

A variance is the sum of the squared residuals divided by their redundancy. The redundancy is the number of residuals
minus the degrees of freedom that the unknowns absorb. The fixed point of the iteration is the restricted maximum
likelihood estimate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_stack
from calibration.solver.adjustment import Adjustment
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.problem import N_SHARED

PRIOR_WEIGHT = 2.0
"""Weight of the prior noise level, as a number of additional residuals."""
MIN_REDUNDANCY = 1e-6
"""Lower limit of the redundancy of an error, which rounding can make negative."""
MIN_NOISE = NoiseLevel(pixel_px=1e-3, robot_m=1e-6, robot_rad=2e-6, smooth_m=1e-6, smooth_rad=2e-6)
"""Lower limits of the estimates. They keep the weights finite if the views have no noise."""


@dataclass(frozen=True, eq=False)
class RobotErrorSquares:
    """Squared robot errors of N views, with the redundancy of the errors."""

    squares: NDArray[np.float64]
    """(N, 2) squared norms of the rotation error (rad^2) and the translation error (m^2); 0 for unused views."""
    redundancy: NDArray[np.float64]
    """(N, 2) redundancy of the rotation error and the translation error, at most 3 each; 0 for unused views."""

    def sigmas(self, priors: NoisePriors, excluded: int | None = None) -> NDArray[np.float64]:
        """Return the standard deviations (2,) of the robot rotation (rad) and position (m) error per axis.

        Args:
            priors: Prior noise levels. If `estimate_noise` is False, the method returns the prior robot noise.
            excluded: Index of a view to ignore. None: use all views.
        """
        prior = np.array([priors.robot_rad, priors.robot_m])
        if not priors.estimate_noise:
            return prior
        rows = np.ones(len(self.squares), dtype=np.bool_)
        if excluded is not None:
            rows[excluded] = False
        squares = self.squares[rows].sum(axis=0) + PRIOR_WEIGHT * prior**2
        sigmas = np.sqrt(squares / (self.redundancy[rows].sum(axis=0) + PRIOR_WEIGHT))
        return np.maximum(sigmas, [MIN_NOISE.robot_rad, MIN_NOISE.robot_m])


def robot_error_squares(adjusted: Adjustment) -> RobotErrorSquares:
    """Return the squares and the redundancy of the estimated robot errors of a solution."""
    equations = adjusted.normal_equations
    used = adjusted.used[:, None]
    J_shared = np.linalg.solve(equations.H_robot, equations.H_cross)
    covariance = invert_stack(equations.H_robot) + J_shared @ adjusted.shared_covariance @ J_shared.swapaxes(1, 2)
    share = np.einsum("nii->ni", covariance) / adjusted.noise.robot**2
    redundancy = np.clip(3.0 - share.reshape(-1, 2, 3).sum(axis=2), MIN_REDUNDANCY, 3.0)
    squares = (adjusted.unknowns.robot_errors**2).reshape(-1, 2, 3).sum(axis=2)
    return RobotErrorSquares(np.where(used, squares, 0.0), np.where(used, redundancy, 0.0))


def estimate_noise(priors: NoisePriors, adjusted: Adjustment) -> NoiseLevel:
    """Estimate the noise levels of corners and robot by one step of variance component estimation.

    Args:
        priors: Prior noise levels.
        adjusted: The current solution. Its normal equations are weighted by its noise levels.
    """
    robot = robot_error_squares(adjusted)
    robot_rad, robot_m = robot.sigmas(priors)
    smooth_rad, smooth_m = _smooth_sigmas(priors, adjusted)
    return NoiseLevel(
        pixel_px=max(_pixel_sigma(priors, adjusted, robot), MIN_NOISE.pixel_px),
        robot_m=float(robot_m),
        robot_rad=float(robot_rad),
        smooth_m=max(float(smooth_m), MIN_NOISE.smooth_m),
        smooth_rad=max(float(smooth_rad), MIN_NOISE.smooth_rad),
    )


def _pixel_sigma(priors: NoisePriors, adjusted: Adjustment, robot: RobotErrorSquares) -> float:
    """Return the standard deviation of the corner noise per image coordinate, pixels."""
    used = adjusted.used
    equations = adjusted.normal_equations
    shared_covariance = adjusted.shared_covariance
    freedom_of_priors = float(np.sum(np.diag(shared_covariance) * np.diag(equations.H_prior)))
    freedom_of_robot = 6.0 * used.sum() - float(robot.redundancy.sum())
    freedom_of_corners = 6.0 * used.sum() + len(shared_covariance) - freedom_of_priors - freedom_of_robot
    redundancy = max(2.0 * float(adjusted.inliers[used].sum()) - freedom_of_corners, 1.0)
    squares = float(equations.squares_px2[used].sum())
    return float(np.sqrt((squares + PRIOR_WEIGHT * priors.pixel_px**2) / (redundancy + PRIOR_WEIGHT)))


def _smooth_sigmas(priors: NoisePriors, adjusted: Adjustment) -> NDArray[np.float64]:
    """Return the standard deviations (2,) of the smooth rotation (rad) and position (m) errors per axis."""
    weights = adjusted.unknowns.smooth_weights
    share = np.diag(adjusted.shared_covariance)[N_SHARED:] / adjusted.noise.smooth_sigmas(len(weights)) ** 2
    redundancy = np.clip(1.0 - share, MIN_REDUNDANCY, 1.0).reshape(-1, 2, 3).sum(axis=(0, 2))
    squares = (weights**2).reshape(-1, 2, 3).sum(axis=(0, 2))
    prior = np.array([priors.smooth_rad, priors.smooth_m])
    return np.sqrt((squares + PRIOR_WEIGHT * prior**2) / (redundancy + PRIOR_WEIGHT))
