"""Merge all registered views into one cloud (section II.E)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.geometry.outlier_filter import inlier_mask
from recognition.geometry.voxel_grid import voxel_means
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud

MAX_POINTS = 150_000
"""Maximum number of points of the merged cloud. A metre of string has about 10,000 points. More points slow down the
later stages."""
VOXEL_RADII = 1 / 3
"""Edge length of the voxels, in radii r. Eight views overlap and measure the same surface many times."""
MIN_NORMAL_LENGTH = 0.1
"""Minimum length of the mean normal of a voxel. In a shorter mean normal, opposite normals have cancelled, so the side
of the surface is unknown."""


def merge_clouds(
    clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Merge the views into one cloud: average the points in each voxel, then remove outliers.

    Args:
        clouds: Registered views, base frame.
        parameters: Method parameters; uses the radius r.

    Returns:
        Points (N, 3), metres, base frame, and unit normals (N, 3).

    Raises:
        TooCrowdedError: The merged cloud has more than `MAX_POINTS` points.

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
    points = points[has_side]
    normals = normals[has_side] / length[has_side]
    is_inlier = inlier_mask(points)
    return points[is_inlier], normals[is_inlier]
