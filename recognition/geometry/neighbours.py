"""Sums and means over neighbourhoods and groups of points, for all of them at once."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree


def neighbour_pairs(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of points within `radius` of each other, in both orders, and each point with itself.

    Args:
        points: (N, 3) points, metres.
        radius: Largest distance of a pair, metres.

    Returns:
        (P,) and (P,) indices of the first and of the second point of each pair.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    i, j = KDTree(points).query_pairs(radius, output_type="ndarray").T
    own = np.arange(len(points))
    return np.concatenate([i, j, own]), np.concatenate([j, i, own])


def neighbour_matrix(centres: NDArray[np.float64], points: NDArray[np.float64], radius: float) -> csr_array:
    """Return the sparse matrix A that marks which points lie within `radius` of which centre.

    `A @ values` sums over the neighbourhoods, and `A.sum(axis=1)` counts their points. If `centres` is `points`, each
    point is its own neighbour.

    Args:
        centres: (M, 3) centres, metres.
        points: (N, 3) points, metres.
        radius: Radius of the neighbourhoods, metres.

    Returns:
        (M, N) matrix of ones and zeros.
    """
    if centres is points:
        # This search finds each pair once and without its distance, which takes half the time.
        i, j = neighbour_pairs(points, radius)
    else:
        pairs = KDTree(centres).sparse_distance_matrix(KDTree(points), radius, output_type="ndarray")
        i, j = pairs["i"], pairs["j"]
    # Indices of half the size are converted to rows faster.
    i, j = i.astype(np.int32), j.astype(np.int32)
    return csr_array((np.ones(len(i)), (i, j)), shape=(len(centres), len(points)))


def neighbourhood_means(
    centres: NDArray[np.float64], points: NDArray[np.float64], values: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Return the means of `values` over the points within `radius` of each centre.

    Args:
        centres: (M, 3) centres, metres.
        points: (N, 3) points, metres.
        values: (N, K) values of the points.
        radius: Radius of the neighbourhoods, metres.

    Returns:
        (M, K) means; NaN for a centre without a point within the radius.
    """
    A = neighbour_matrix(centres, points, radius)
    with np.errstate(invalid="ignore"):
        return (A @ values) / np.asarray(A.sum(axis=1))[:, None]


def group_sums(group: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the sums of `values` over the rows of each group.

    Args:
        group: (P,) group of each row, 0 to `count` - 1.
        values: (P,) or (P, K) values.
        count: Number of groups.

    Returns:
        (count,) or (count, K) sums; 0 for a group without rows.
    """
    if values.ndim == 1:
        return np.bincount(group, values, count).astype(np.float64)
    return np.column_stack([group_sums(group, column, count) for column in values.T])
