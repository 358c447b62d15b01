"""Statistical outlier filter (section II.C)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 8
"""Neighbours, the point itself among them, whose mean distance is looked at."""
SURFACE_RATIO = 2.0
"""Standard deviations above the mean at which a point of a measured surface is an outlier."""
LINE_RATIO = 6.0
"""The same for a centre line cloud. It lies so evenly along its line that the points between two crossing
strands, which show the intersection, would be taken for outliers by the usual 2."""


def inlier_mask(points: NDArray[np.float64], ratio: float = SURFACE_RATIO) -> NDArray[np.bool_]:
    """(N,) mask of the points (N, 3) whose neighbours are not unusually far (the filter of the paper's [11]).

    A point is an outlier when the mean distance to its neighbours exceeds the cloud's mean of that by `ratio`
    standard deviations. The paper gives no figures. Clouds too small for the statistic are kept whole.
    """
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    # Open3D's filter has the same rule but takes points that coincide for outliers.
    distances, _ = KDTree(points).query(points, NEIGHBOURS)
    mean = distances.mean(axis=1)
    return mean <= mean.mean() + ratio * mean.std(ddof=1)
