"""Thinning clouds to one point a voxel."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums


def voxel_indices(points: NDArray[np.float64], size: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(N,) number of the voxel of edge `size` that each of the points (N, 3) is in, and (M,) how many each holds.

    The grid begins at the cloud's lowest corner. Voxels are numbered in the order of x, y, z.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    cell = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    shape = cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    _, voxel, count = np.unique(key, return_inverse=True, return_counts=True)
    return voxel, count


def voxel_means(
    points: NDArray[np.float64], size: float, values: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means (M, 3) of the points (N, 3) in each voxel of edge `size`, and those of `values` (N, K), (M, K)."""
    values = np.empty((len(points), 0)) if values is None else values
    if len(points) == 0:
        return points.reshape(0, 3), values
    voxel, count = voxel_indices(points, size)
    stacked = group_sums(voxel, np.hstack([points, values]), len(count)) / count[:, None]
    return stacked[:, :3], stacked[:, 3:]
