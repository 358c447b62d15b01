"""One cloud of all registered views (section II.E)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.geometry.outlier_filter import inlier_mask
from recognition.geometry.voxel_grid import voxel_means
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud

MAX_POINTS = 150_000
"""Merged points taken, of which a metre of string has about 10,000: what comes after grows with their neighbours."""
VOXEL_SHARE = 1 / 3
"""The merged cloud is thinned to voxels of this share of r: eight views overlap and say the same many times."""


def merge_clouds(
    clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals, (N, 3) each, of all clouds together: averaged in voxels, outliers removed.

    Raises:
        TooCrowdedError: more points than strings have.
    """
    points, normals = voxel_means(
        np.vstack([cloud.points for cloud in clouds]),
        parameters.r * VOXEL_SHARE,
        np.vstack([cloud.normals for cloud in clouds]),
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Opposite normals in one voxel cancel: such a point has no side.
    sided = length[:, 0] > 0.1
    if sided.sum() > MAX_POINTS:
        raise TooCrowdedError(
            f"the views together have {sided.sum()} points above the table, more than {MAX_POINTS}: "
            "check the table's height, the workspace and the string's radius"
        )
    points, normals = points[sided], normals[sided] / length[sided]
    kept = inlier_mask(points)
    return points[kept], normals[kept]
