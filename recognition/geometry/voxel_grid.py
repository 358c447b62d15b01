"""Voxel grids: the voxel of each point, and one point per voxel."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums


def voxel_indices(points: NDArray[np.float64], size: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the voxel index of each point, and the number of points in each voxel.

    The grid begins at the minimum corner of the cloud. Only voxels with points have an index, in the order of x, y, z.

    Args:
        points: (N, 3) points, metres.
        size: Edge length of a voxel, metres.

    Returns:
        Voxel indices (N,) of the points, and point counts (M,) of the voxels.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    cell = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    shape = cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    _, voxel, count = np.unique(key, return_inverse=True, return_counts=True)
    return voxel, count


def voxel_centres(points: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Return the centres (M, 3) of the voxels with points, in the order of x, y, z.

    The origin is a corner of a voxel.

    Args:
        points: (N, 3) points, metres.
        size: Edge length of a voxel, metres.
    """
    if len(points) == 0:
        return np.empty((0, 3))
    cell = np.floor(points / size).astype(np.int64)
    first = cell.min(axis=0)
    shape = tuple(cell.max(axis=0) - first + 1)
    occupied = np.unravel_index(np.unique(np.ravel_multi_index(tuple((cell - first).T), shape)), shape)
    return (np.stack(occupied, axis=1) + first + 0.5) * size


def voxel_means(
    points: NDArray[np.float64], size: float, values: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean of the points in each voxel, and the mean of their values.

    Args:
        points: (N, 3) points, metres.
        size: Edge length of a voxel, metres.
        values: (N, K) values of the points; None for no values (K = 0).

    Returns:
        Mean points (M, 3), metres, and mean values (M, K), for the M voxels that have points.
    """
    if values is None:
        values = np.empty((len(points), 0))
    voxel, count = voxel_indices(points, size)
    stacked = group_sums(voxel, np.hstack([points, values]), len(count)) / count[:, None]
    return stacked[:, :3], stacked[:, 3:]
