"""Statistical outlier filter (section II.C)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 8
"""Number of nearest points over which the mean distance is taken, including the point itself."""
SURFACE_RATIO = 2.0
"""Standard deviations above the mean from which a point of a measured surface is an outlier."""
LINE_RATIO = 6.0
"""Standard deviations above the mean from which a point of a centre line cloud is an outlier. Such a cloud lies evenly
along its line. The usual 2 would remove the points between two crossing strands, which show the intersection."""


def inlier_mask(points: NDArray[np.float64], ratio: float = SURFACE_RATIO) -> NDArray[np.bool_]:
    """Return the mask of the points that are not unusually far from their neighbours.

    A point is an outlier if the mean distance to its neighbours exceeds the average over the cloud by `ratio` standard
    deviations. A cloud of `NEIGHBOURS` points or fewer is too small for the statistic and has no outliers.

    Args:
        points: (N, 3) points, metres.
        ratio: Number of standard deviations.

    Returns:
        (N,) mask, True for the points to keep.

    Source:
        Section II.C, the filter of the paper's reference [11]. The paper gives no figures; those here are ours.
    """
    if len(points) <= NEIGHBOURS:
        return np.ones(len(points), dtype=bool)
    # Open3D's filter has the same rule but treats coincident points as outliers.
    distances, _ = KDTree(points).query(points, NEIGHBOURS)
    mean = distances.mean(axis=1)
    return mean <= mean.mean() + ratio * mean.std(ddof=1)
