"""Maximum weight matching of ends, and the margin of each matched pair."""

import numpy as np
import rustworkx
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

GAIN_STEP = 1e-9
"""Resolution of the gains. The gains are rounded to multiples of it, because the matching is exact only on integers."""
MAX_COMPETING_ENDS = 300
"""Maximum number of competing ends for which margins are computed. Each matched pair takes one more matching.
Real scenes have tens of competing ends."""


def maximum_weight_matching(a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs with the largest sum of gains. Each end is in at most one pair.

    Args:
        a: (M,) first end of each candidate pair. Each pair may occur only once.
        b: (M,) second end of each candidate pair.
        gain: (M,) gain of each candidate pair, finite.

    Returns:
        Indices (K,) of the matched pairs, ascending.
    """
    ends, nodes = np.unique(np.concatenate([a, b]), return_inverse=True)
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(ends.tolist())
    graph.add_edges_from(list(zip(*nodes.reshape(2, -1).tolist(), range(len(a)), strict=True)))
    weights = np.rint(gain / GAIN_STEP).astype(np.int64).tolist()
    matched = rustworkx.max_weight_matching(graph, weight_fn=weights.__getitem__)
    return np.array(sorted(graph.get_edge_data(j, k) for j, k in matched), dtype=np.int64)


def matching_margins(
    matched: NDArray[np.int64], a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the margin of each matched pair: the loss of total gain in the best matching without the pair.

    Two ends compete if candidate pairs connect them, directly or through other ends. Each group of competing ends is
    matched separately.

    Args:
        matched: (K,) result of `maximum_weight_matching` for the same `a`, `b` and `gain`.
        a: (M,) first end of each candidate pair.
        b: (M,) second end of each candidate pair.
        gain: (M,) gain of each candidate pair, finite.

    Returns:
        Margins (K,), not negative. The margin is 0 in a group of more than `MAX_COMPETING_ENDS` ends.
    """
    if len(matched) == 0:
        return np.empty(0)
    count = int(max(a.max(), b.max())) + 1
    _, group_of_end = connected_components(csr_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    group_sizes = np.bincount(group_of_end)
    margins = np.zeros(len(matched))
    for k, pair in enumerate(matched):
        group = group_of_end[a[pair]]
        if group_sizes[group] <= MAX_COMPETING_ENDS:
            others = np.flatnonzero((group_of_end[a] == group) & (np.arange(len(a)) != pair))
            without = others[maximum_weight_matching(a[others], b[others], gain[others])]
            margins[k] = gain[matched[group_of_end[a[matched]] == group]].sum() - gain[without].sum()
    return margins
