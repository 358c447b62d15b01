"""Which of many couples of ends to take: each end in one at most, and the largest gain in sum."""

import numpy as np
import rustworkx
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

FINEST = 1e-9
"""The matching reckons in whole numbers, so that it is exact: gains in steps of this."""
MOST_RIVALS = 300
"""Ends that compete with one another, of which a margin is told. Each is a matching more; real scenes have tens."""


def maximum_weight_matching(a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which couples to take for the largest gain in sum: a matching of maximum weight.

    Args:
        a, b: (M,) and (M,) the two ends of each couple there may be; no couple twice.
        gain: (M,) of each, finite.

    Returns:
        (K,) indices of couples, ascending.
    """
    ends, nodes = np.unique(np.concatenate([a, b]), return_inverse=True)
    graph = rustworkx.PyGraph(multigraph=False)
    graph.add_nodes_from(ends.tolist())
    graph.add_edges_from(list(zip(*nodes.reshape(2, -1).tolist(), range(len(a)), strict=True)))
    weights = np.rint(gain / FINEST).astype(np.int64).tolist()
    taken = rustworkx.max_weight_matching(graph, weight_fn=weights.__getitem__)
    return np.array(sorted(graph.get_edge_data(j, k) for j, k in taken), dtype=np.int64)


def matching_margins(
    taken: NDArray[np.int64], a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(K,) how much each of the couples `taken` is ahead of doing without it; 0 where too many compete to tell.

    Ends that no couple links directly or through others don't compete: each such group is looked at by itself.

    Args:
        taken: (K,) the answer of `maximum_weight_matching` to the same a, b and gain.
    """
    if len(taken) == 0:
        return np.empty(0)
    count = int(max(a.max(), b.max())) + 1
    _, group = connected_components(csr_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    rivals = np.bincount(group)
    margins = np.zeros(len(taken))
    for place, couple in enumerate(taken):
        number = group[a[couple]]
        if rivals[number] <= MOST_RIVALS:
            others = np.flatnonzero((group[a] == number) & (np.arange(len(a)) != couple))
            without = others[maximum_weight_matching(a[others], b[others], gain[others])]
            margins[place] = gain[taken[group[a[taken]] == number]].sum() - gain[without].sum()
    return margins
