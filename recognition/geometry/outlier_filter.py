"""Statistical outlier filter (section II.C)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 8
"""Number of nearest points in the mean distance of a point, including the point itself."""
SURFACE_RATIO = 2.0
"""Outlier threshold for points of a measured surface, in standard deviations above the average."""
LINE_RATIO = 6.0
"""Outlier threshold for points of a centre line cloud, in standard deviations above the average.

The points lie evenly along the line. The usual threshold of 2 would remove points between two crossing strands, and
these points show the intersection.
"""


def inlier_mask(points: NDArray[np.float64], ratio: float = SURFACE_RATIO) -> NDArray[np.bool_]:
    """Return the inlier mask of a cloud by the statistical outlier filter.

    A point is an outlier if its mean distance to its neighbours exceeds the average over the cloud by more than `ratio`
    standard deviations. A cloud of at most `NEIGHBOURS` points is too small for the filter and has no outliers.

    Args:
        points: (N, 3) points, metres.
        ratio: Outlier threshold, in standard deviations above the average.

    Returns:
        Mask (N,), True for inliers.

    Source:
        Section II.C, the filter of the paper's reference [11]. The paper gives no values for the constants.
    """
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    # The filter of Open3D has the same rule, but treats coincident points as outliers.
    distances, _ = KDTree(points).query(points, NEIGHBOURS)
    mean = distances.mean(axis=1)
    return mean <= mean.mean() + ratio * mean.std(ddof=1)
