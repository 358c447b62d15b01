"""Sums and means over neighbourhoods and groups of points, vectorised."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree


def neighbour_pairs(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of points at most `radius` apart, in both orders, and the pair of each point with itself.

    Args:
        points: (N, 3) points, metres.
        radius: Maximum distance of a pair, metres.

    Returns:
        Indices (P,) of the first point and indices (P,) of the second point of each pair.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    i, j = KDTree(points).query_pairs(radius, output_type="ndarray").T
    own = np.arange(len(points))
    return np.concatenate([i, j, own]), np.concatenate([j, i, own])


def pairs_between(points: KDTree, others: KDTree, radius: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of a point and another point at most `radius` apart.

    Args:
        points: Search tree of the points.
        others: Search tree of the other points.
        radius: Maximum distance of a pair, metres.

    Returns:
        Indices (P,) of the point and indices (P,) of the other point of each pair.
    """
    pairs = points.sparse_distance_matrix(others, radius, output_type="ndarray")
    return pairs["i"], pairs["j"]


def neighbour_matrix(centres: NDArray[np.float64], points: NDArray[np.float64], radius: float) -> csr_array:
    """Return the sparse matrix A with A[i, j] = 1 if point j lies within `radius` of centre i.

    `A @ values` sums over the neighbourhoods, and `A.sum(axis=1)` counts their points. If `centres` is `points`, each
    point is its own neighbour.

    Args:
        centres: (M, 3) centres, metres.
        points: (N, 3) points, metres.
        radius: Radius of the neighbourhoods, metres.

    Returns:
        Matrix (M, N) of ones and zeros.
    """
    if centres is points:
        # This search finds each pair once and computes no distance. It takes half the time.
        i, j = neighbour_pairs(points, radius)
    else:
        i, j = pairs_between(KDTree(centres), KDTree(points), radius)
    # The conversion to rows is faster with 32-bit indices.
    indices = (i.astype(np.int32), j.astype(np.int32))
    return csr_array((np.ones(len(i)), indices), shape=(len(centres), len(points)))


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
        Means (M, K); NaN for a centre without points.
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
        Sums (count,) or (count, K); 0 for a group without rows.
    """
    if values.ndim == 1:
        return np.bincount(group, values, count).astype(np.float64)
    return np.column_stack([group_sums(group, column, count) for column in values.T])
