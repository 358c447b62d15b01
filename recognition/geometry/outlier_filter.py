"""Statistical outlier filter (section II.C)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 8
"""Number of nearest points in the mean distance of a point, including the point itself."""
SURFACE_RATIO = 2.0
"""Threshold for a point of a measured surface, in standard deviations above the mean."""
LINE_RATIO = 6.0
"""Threshold for a point of a centre line cloud, in standard deviations above the mean.

The points lie evenly along the line. The usual threshold of 2 would remove points between two crossing strands, and
these points show the intersection.
"""


def inlier_mask(points: NDArray[np.float64], ratio: float = SURFACE_RATIO) -> NDArray[np.bool_]:
    """Return the mask of the points whose mean distance to their neighbours is not unusually large.

    A point is an outlier if its mean distance exceeds the average over the cloud by `ratio` standard deviations. In a
    cloud of at most `NEIGHBOURS` points, no point is an outlier, because the statistic needs more points.

    Args:
        points: (N, 3) points, metres.
        ratio: Threshold, in standard deviations above the mean.

    Returns:
        Mask (N,), True for inliers.

    Source:
        Section II.C, the filter of reference [11]. The paper gives no values for the constants.
    """
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    # The filter of Open3D has the same rule, but coincident points are outliers there.
    distances, _ = KDTree(points).query(points, NEIGHBOURS)
    mean = distances.mean(axis=1)
    return mean <= mean.mean() + ratio * mean.std(ddof=1)
