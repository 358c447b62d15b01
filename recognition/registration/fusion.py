"""Merging of all registered views into one cloud (section II.E)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.geometry.outlier_filter import inlier_mask
from recognition.geometry.voxel_grid import voxel_means
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud

MAX_POINTS = 150_000
"""Maximum number of merged points. A metre of string has about 10,000; the later stages slow down with the number of
neighbours of a point."""
VOXEL_RADII = 1 / 3
"""Edge length of the voxels, in radii r. Eight views overlap and measure the same surface many times."""
MIN_NORMAL_LENGTH = 0.1
"""Minimum length of the mean normal of a voxel. Opposite normals cancel, and such a point has no known side."""


def merge_clouds(
    clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one cloud of all views, averaged in voxels and without outliers.

    Args:
        clouds: The views as registered.
        parameters: Parameters of the method, for the radius r.

    Returns:
        Points (N, 3), metres, base frame, and unit normals (N, 3).

    Raises:
        TooCrowdedError: There are more points than strings have.

    Source:
        Section II.E.
    """
    points, normals = voxel_means(
        np.vstack([cloud.points for cloud in clouds]),
        parameters.r * VOXEL_RADII,
        np.vstack([cloud.normals for cloud in clouds]),
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    has_side = length[:, 0] > MIN_NORMAL_LENGTH
    if has_side.sum() > MAX_POINTS:
        raise TooCrowdedError(
            f"the views together have {has_side.sum()} points above the table, more than {MAX_POINTS}: "
            "check the height of the table, the workspace and the radius of the string"
        )
    points, normals = points[has_side], normals[has_side] / length[has_side]
    is_inlier = inlier_mask(points)
    return points[is_inlier], normals[is_inlier]
