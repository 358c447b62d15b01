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
    """Centre line point cloud, before and after averaging."""

    surface: NDArray[np.float64]
    """(N, 3) surface points from which the centre line was estimated, metres, base frame."""
    unaveraged: NDArray[np.float64]
    """(N, 3) noisy points c_i of eq. (1), metres. Unlike the means, these points reach the ends of the string."""
    r: float
    """String radius, metres."""

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(M, 3) means of eq. (2) over the points within 2 r of p_i, without outliers, metres, base frame."""
        means = neighbourhood_means(self.surface, self.surface, self.unaveraged, 2 * self.r)
        return means[inlier_mask(means, LINE_RATIO)]


def estimate_centre_line(
    points: NDArray[np.float64], normals: NDArray[np.float64], parameters: ChainParameters
) -> CentreLine:
    """Estimate the centre line point cloud from the surface.

    Each surface point moves inwards by the string radius: c_i = p_i - r n_i (eq. 1). The mean over the points within
    2 r of p_i (eq. 2) reduces the error of the normals.

    Args:
        points: (N, 3) surface points, metres, base frame.
        normals: (N, 3) outward unit normals.
        parameters: Method parameters; uses the radius r.

    Returns:
        The points of eq. (1), and their means of eq. (2) without outliers.

    Source:
        Section II.F, eqs. (1) and (2).
    """
    return CentreLine(points, points - parameters.r * normals, parameters.r)
