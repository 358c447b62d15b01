"""State of the bundle adjustment: unknowns, noise levels, and the views and corners that determine them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.solver.noise import NoiseLevel
from calibration.solver.problem import N_SHARED, NormalEquations, Unknowns


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
    """False if too many steps were needed, or if no step decreased the cost."""

    @cached_property
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
