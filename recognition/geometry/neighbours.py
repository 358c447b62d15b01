"""Sums over neighbourhoods and groups of points, for all of them at once."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree


def neighbour_pairs(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(P,) and (P,): both orders of each pair of points (N, 3) within `radius`, and each point with itself."""
    if len(points) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    i, j = KDTree(points).query_pairs(radius, output_type="ndarray").T
    itself = np.arange(len(points))
    return np.concatenate([i, j, itself]), np.concatenate([j, i, itself])


def neighbour_matrix(centres: NDArray[np.float64], points: NDArray[np.float64], radius: float) -> csr_array:
    """(M, N) matrix with a one where point j (of N) lies within `radius` of centre i (of M).

    `A @ values` then sums over the neighbourhoods, `A.sum(axis=1)` counts them. With `centres` being `points`
    each point counts as its own neighbour.
    """
    if centres is points:
        # Each pair is found once, and without its distance: half the time.
        i, j = neighbour_pairs(points, radius)
    else:
        pairs = KDTree(centres).sparse_distance_matrix(KDTree(points), radius, output_type="ndarray")
        i, j = pairs["i"], pairs["j"]
    # Of half the size, and so made into rows faster.
    i, j = i.astype(np.int32), j.astype(np.int32)
    return csr_array((np.ones(len(i)), (i, j)), shape=(len(centres), len(points)))


def neighbourhood_means(
    centres: NDArray[np.float64], points: NDArray[np.float64], values: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """(M, K) means of `values` (N, K) over the `points` (N, 3) within `radius` of each centre (M, 3).

    NaN in the rows whose centre has no point near.
    """
    A = neighbour_matrix(centres, points, radius)
    with np.errstate(invalid="ignore"):
        return (A @ values) / np.asarray(A.sum(axis=1))[:, None]


def group_sums(group: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """(count,) or (count, K) sums of `values` (P,) or (P, K) over the rows of each `group` (P,), 0 to count - 1."""
    if values.ndim == 1:
        return np.bincount(group, values, count).astype(np.float64)
    return np.column_stack([group_sums(group, column, count) for column in values.T])
