"""Where rods touch the table or one another. Lengths are in radii of the rods, which all have one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def strand_numbers(nodes: Sequence[NDArray[np.float64]]) -> NDArray[np.int64]:
    """For each node of all rods, stacked, the number of its rod."""
    return np.repeat(np.arange(len(nodes)), [len(n) for n in nodes])


def contacts(x: NDArray[np.float64], string: NDArray[np.int64], softness: float):
    """What stands in something: rows (M, 3 N) that give each contact's opening from moves of the nodes, and how deep.

    `x` (N, 3) are the rods' nodes, `string` (N,) their rods. Rods touch where segments come nearer than
    `softness * 2`, the table where nodes are lower than 1.
    """
    from scipy.sparse import csr_array

    i, j, share_i, share_j, apart = _near_segments(x, string, 2 * softness)
    distance = np.linalg.norm(apart, axis=1)
    normal = apart / distance[:, None]
    low = np.nonzero(x[:, 2] < 1.0)[0]
    row = np.arange(len(i))
    nodes = np.column_stack([i, i + 1, j, j + 1])
    weights = np.column_stack([1 - share_i, share_i, share_j - 1, -share_j])
    data = np.concatenate([(weights[:, :, None] * normal[:, None]).ravel(), np.ones(len(low))])
    columns = np.concatenate([(3 * nodes[:, :, None] + np.arange(3)).ravel(), 3 * low + 2])
    rows = np.concatenate([np.repeat(row, 12), len(i) + np.arange(len(low))])
    depth = np.concatenate([2 * softness - distance, 1.0 - x[low, 2]])
    return csr_array((data, (rows, columns)), shape=(len(depth), x.size)), depth


def _near_segments(x: NDArray[np.float64], string: NDArray[np.int64], apart: float):
    """Segments nearer than `apart`, where on them (0 to 1) they are nearest, and the vector from second to first."""
    from scipy.spatial import KDTree

    segment = np.nonzero(string[1:] == string[:-1])[0]
    edge = x[segment + 1] - x[segment]
    long = float(np.linalg.norm(edge, axis=1).max())
    m, n = KDTree(x[segment] + edge / 2).query_pairs(apart + long, output_type="ndarray").T
    m, n = np.minimum(m, n), np.maximum(m, n)
    order = np.lexsort((n, m))
    m, n = m[order], n[order]
    # Along one rod, half the tightest turn lies between points that touch.
    other = (string[segment[m]] != string[segment[n]]) | ((segment[n] - segment[m]) * long > 1.2 * np.pi)
    m, n = m[other], n[other]
    share_m, share_n = _nearest(x[segment[m]], edge[m], x[segment[n]], edge[n])
    vector = x[segment[m]] + share_m[:, None] * edge[m] - x[segment[n]] - share_n[:, None] * edge[n]
    near = np.linalg.norm(vector, axis=1) < apart
    return segment[m][near], segment[n][near], share_m[near], share_n[near], vector[near]


def _nearest(p: NDArray[np.float64], u: NDArray[np.float64], q: NDArray[np.float64], v: NDArray[np.float64]):
    """Shares (M,) at which the segments p + s u and q + t v come nearest to one another."""
    between = p - q
    a, b, c = (np.einsum("ij,ij->i", d, e) for d, e in ((u, u), (u, v), (v, v)))
    d, e = np.einsum("ij,ij->i", u, between), np.einsum("ij,ij->i", v, between)
    s = np.clip((b * e - c * d) / np.maximum(a * c - b * b, 1e-9 * a * c), 0.0, 1.0)
    t = np.clip((b * s + e) / c, 0.0, 1.0)
    # With t at a limit, the best s is another.
    return np.clip((b * t - d) / a, 0.0, 1.0), t
