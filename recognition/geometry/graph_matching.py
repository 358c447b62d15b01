"""Maximum weight matching of ends, and the margin of each matched pair."""

import heapq
from dataclasses import dataclass, field

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
MAX_BRANCHES = 100
"""Maximum number of branches of the search for a matching without conflicts. Knots need a few branches."""
NO_CONFLICTS = np.empty((0, 2), dtype=np.int64)
"""No conflicts between candidate pairs."""


@dataclass(order=True)
class _Branch:
    """Branch of the search for a matching without conflicts. The largest gain is first, then the oldest branch."""

    negative_gain: float
    """Sum of the gains of the matched pairs, negative because a heap pops the smallest element."""
    number: int
    """Number of the branch, in the order of creation."""
    matched: NDArray[np.int64] = field(compare=False)
    """(K,) indices of the matched pairs, ascending."""
    excluded: frozenset[int] = field(compare=False)
    """Indices of the pairs that the branch excludes."""


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


def matching_without_conflicts(
    a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64], conflicts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the pairs with the largest sum of gains, of which no two are in conflict.

    A matching without regard to conflicts gains at least as much. If it contains a conflict, the search branches: one
    of the two pairs is excluded in each branch. The branch with the largest gain is always continued first, so that the
    first matching without a conflict is the best one.

    Args:
        a: (M,) first end of each candidate pair. Each pair may occur only once.
        b: (M,) second end of each candidate pair.
        gain: (M,) gain of each candidate pair, finite.
        conflicts: (L, 2) indices of pairs that cannot both be chosen.

    Returns:
        Indices (K,) of the matched pairs, ascending. After `MAX_BRANCHES` branches, the pair with the smaller gain of
        each remaining conflict is dropped.
    """
    matched = maximum_weight_matching(a, b, gain)
    if len(conflicts) == 0:
        return matched
    branches = [_Branch(-float(gain[matched].sum()), 0, matched, frozenset())]
    n_branches = 1
    for _ in range(MAX_BRANCHES):
        best = heapq.heappop(branches)
        broken = conflicts[np.isin(conflicts, best.matched).all(axis=1)]
        if len(broken) == 0:
            return best.matched
        for pair in broken[0].tolist():
            excluded = best.excluded | {pair}
            kept = np.setdiff1d(np.arange(len(a)), sorted(excluded))
            matched = kept[maximum_weight_matching(a[kept], b[kept], gain[kept])]
            heapq.heappush(branches, _Branch(-float(gain[matched].sum()), n_branches, matched, excluded))
            n_branches += 1
    matched = branches[0].matched
    for pair in conflicts[np.isin(conflicts, matched).all(axis=1)]:
        # An earlier conflict may already have dropped one of the two pairs.
        if np.isin(pair, matched).all():
            weaker = pair[np.argmin(gain[pair])]
            matched = np.setdiff1d(matched, weaker)
    return matched


def matching_margins(
    matched: NDArray[np.int64],
    a: NDArray[np.int64],
    b: NDArray[np.int64],
    gain: NDArray[np.float64],
    conflicts: NDArray[np.int64] = NO_CONFLICTS,
) -> NDArray[np.float64]:
    """Return the margin of each matched pair: the loss of total gain in the best matching without the pair.

    Two ends compete if candidate pairs connect them, directly or through other ends, or if such pairs are in conflict.
    Each group of competing ends is matched separately.

    Args:
        matched: (K,) result of `matching_without_conflicts` for the same arguments.
        a: (M,) first end of each candidate pair.
        b: (M,) second end of each candidate pair.
        gain: (M,) gain of each candidate pair, finite.
        conflicts: (L, 2) indices of pairs that cannot both be chosen.

    Returns:
        Margins (K,), not negative. The margin is 0 in a group of more than `MAX_COMPETING_ENDS` ends.
    """
    if len(matched) == 0:
        return np.empty(0)
    n = int(max(a.max(), b.max())) + 1
    row = np.concatenate([a, a[conflicts[:, 0]]])
    column = np.concatenate([b, a[conflicts[:, 1]]])
    competes = csr_array((np.ones(len(row)), (row, column)), shape=(n, n))
    _, group_of_end = connected_components(competes, directed=False)
    group_sizes = np.bincount(group_of_end)
    margins = np.zeros(len(matched))
    for k, pair in enumerate(matched):
        group = group_of_end[a[pair]]
        if group_sizes[group] > MAX_COMPETING_ENDS:
            continue
        is_in_group = group_of_end[a] == group
        others = np.flatnonzero(is_in_group & (np.arange(len(a)) != pair))
        inside = np.searchsorted(others, conflicts[np.isin(conflicts, others).all(axis=1)])
        without = others[matching_without_conflicts(a[others], b[others], gain[others], inside)]
        margins[k] = gain[matched[is_in_group[matched]]].sum() - gain[without].sum()
    return margins
