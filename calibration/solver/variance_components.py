"""How large the noise of the corners and of the robot is, from how large their errors came out: variance components.

Each sum of squared errors is divided by its redundancy, the number of its errors less what the unknowns took up of them
(Foerstner's estimate; at its fixed point it is the restricted maximum likelihood).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_stack
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.problem import SHARED, NormalEquations, Unknowns

PRIOR_ERRORS = 2.0
"""The assumed level counts as this many errors beside those of the views."""
LEAST = NoiseLevel(pixel_px=1e-3, robot_m=1e-6, robot_rad=2e-6)
"""Where views are exact, the estimates end here, and the weights stay finite."""


@dataclass(frozen=True, eq=False)
class RobotSpread:
    """Squared robot errors of N views and how many errors they are worth; of rotation (rad), then translation (m)."""

    squares: NDArray[np.float64]
    """(N, 2)."""
    redundancy: NDArray[np.float64]
    """(N, 2) of three each."""

    def sigmas(self, assumed: NoisePriors, but: int | None = None) -> NDArray[np.float64]:
        """(2,) the robot's noise, by all views or by all but one."""
        told = np.array([assumed.robot_rad, assumed.robot_m])
        if not assumed.estimate_noise:
            return told
        rows = np.arange(len(self.squares)) != but
        squares = self.squares[rows].sum(axis=0) + PRIOR_ERRORS * told**2
        sigmas = np.sqrt(squares / (self.redundancy[rows].sum(axis=0) + PRIOR_ERRORS))
        return np.maximum(sigmas, [LEAST.robot_rad, LEAST.robot_m])


def robot_spread(
    errors: NDArray[np.float64],
    noise: NoiseLevel,
    system: NormalEquations,
    shared_covariance: NDArray[np.float64],
    used: NDArray[np.bool_],
) -> RobotSpread:
    """Of the robot `errors` (N, 6); of views not `used` there is none."""
    taken = np.linalg.solve(system.own, system.mixed)
    covariance = invert_stack(system.own) + taken @ shared_covariance @ taken.swapaxes(1, 2)
    share = np.einsum("nii->ni", covariance) / noise.robot**2
    redundancy = np.clip(3.0 - share.reshape(-1, 2, 3).sum(axis=2), 1e-6, 3.0)
    squares = (errors**2).reshape(-1, 2, 3).sum(axis=2)
    return RobotSpread(np.where(used[:, None], squares, 0.0), np.where(used[:, None], redundancy, 0.0))


def estimate_noise(
    assumed: NoisePriors,
    noise: NoiseLevel,
    unknowns: Unknowns,
    system: NormalEquations,
    used: NDArray[np.bool_],
    good: NDArray[np.bool_],
) -> NoiseLevel:
    """The noise by the views `used` (N,) and their corners `good` (N, M), around the present `noise`."""
    shared_covariance = invert_stack(system.shared_information(used))
    spread = robot_spread(unknowns.errors, noise, system, shared_covariance, used)
    robot_rad, robot_m = spread.sigmas(assumed)
    by_prior = float(np.sum(np.diag(shared_covariance) * np.diag(system.prior)))
    by_robot = 6.0 * used.sum() - float(spread.redundancy.sum())
    by_corners = 6.0 * used.sum() + SHARED - by_prior - by_robot
    redundancy = max(2.0 * float(good[used].sum()) - by_corners, 1.0)
    squares = float(system.squares[used].sum())
    pixel_px = np.sqrt((squares + PRIOR_ERRORS * assumed.pixel_px**2) / (redundancy + PRIOR_ERRORS))
    return NoiseLevel(max(float(pixel_px), LEAST.pixel_px), float(robot_m), float(robot_rad))
