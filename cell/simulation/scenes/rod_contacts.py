"""Contacts of rods with the table and with each other. Lengths are in units of the common radius."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def strand_numbers(nodes: Sequence[NDArray[np.float64]]) -> NDArray[np.int64]:
    """Return the index of the rod of each node, for the stacked nodes of all rods."""
    return np.repeat(np.arange(len(nodes)), [len(n) for n in nodes])


def contacts(x: NDArray[np.float64], string: NDArray[np.int64], softness: float):
    """Return all contacts with their depths.

    Args:
        x: Nodes (N, 3) of all rods.
        string: Rod (N,) of each node.
        softness: Distance of centre lines in contact, relative to 2 radii. Nodes below a height of 1 touch the table.

    Returns:
        Rows (M, 3 N) that map moves of the nodes to the opening of each contact, and depths (M,).
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
    """Return pairs of segments nearer than `apart`, their nearest positions (0 to 1), and the vectors between these."""
    from scipy.spatial import KDTree

    segment = np.nonzero(string[1:] == string[:-1])[0]
    edge = x[segment + 1] - x[segment]
    long = float(np.linalg.norm(edge, axis=1).max())
    m, n = KDTree(x[segment] + edge / 2).query_pairs(apart + long, output_type="ndarray").T
    m, n = np.minimum(m, n), np.maximum(m, n)
    order = np.lexsort((n, m))
    m, n = m[order], n[order]
    # along one rod, touching points are at least half the tightest turn apart
    other = (string[segment[m]] != string[segment[n]]) | ((segment[n] - segment[m]) * long > 1.2 * np.pi)
    m, n = m[other], n[other]
    share_m, share_n = _nearest(x[segment[m]], edge[m], x[segment[n]], edge[n])
    vector = x[segment[m]] + share_m[:, None] * edge[m] - x[segment[n]] - share_n[:, None] * edge[n]
    near = np.linalg.norm(vector, axis=1) < apart
    return segment[m][near], segment[n][near], share_m[near], share_n[near], vector[near]


def _nearest(p: NDArray[np.float64], u: NDArray[np.float64], q: NDArray[np.float64], v: NDArray[np.float64]):
    """Return the positions (M,) at which the segments p + s u and q + t v are nearest."""
    between = p - q
    a, b, c = (np.einsum("ij,ij->i", d, e) for d, e in ((u, u), (u, v), (v, v)))
    d, e = np.einsum("ij,ij->i", u, between), np.einsum("ij,ij->i", v, between)
    s = np.clip((b * e - c * d) / np.maximum(a * c - b * b, 1e-9 * a * c), 0.0, 1.0)
    t = np.clip((b * s + e) / c, 0.0, 1.0)
    # with t at a limit, s must be computed again
    return np.clip((b * t - d) / a, 0.0, 1.0), t
