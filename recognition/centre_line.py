"""Centre line estimation (section II.F)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbourhood_means
from recognition.geometry.outlier_filter import LINE_RATIO, inlier_mask
from recognition.parameters import ChainParameters


@dataclass(frozen=True, eq=False)
class CentreLine:
    """The centre line point cloud."""

    surface: NDArray[np.float64]
    """(N, 3) points it lies under."""
    single: NDArray[np.float64]
    """(N, 3) c_i of eq. (1): noisy, but not drawn inwards at the string's ends."""
    r: float

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(M, 3) means of eq. (2), over the points within 2 r of p_i, outliers removed. Made when first asked for."""
        means = neighbourhood_means(self.surface, self.surface, self.single, 2 * self.r)
        return means[inlier_mask(means, LINE_RATIO)]


def estimate_centre_line(
    points: NDArray[np.float64], normals: NDArray[np.float64], parameters: ChainParameters
) -> CentreLine:
    """Points of the centre line under the surface `points` (N, 3) with outward `normals` (N, 3).

    c_i = p_i - r n_i (eq. 1), then the mean over the points within 2 r of p_i (eq. 2).
    """
    return CentreLine(points, points - parameters.r * normals, parameters.r)
