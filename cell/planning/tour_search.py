"""Search for the tour of the least expected duration: exact for a few viewpoints, local for many.

Some viewpoints may have to be visited first. Their moves count in full, those after them by the share of the tours that
reach them, and the way home from the last one of the first by the share of the tours that end there.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.planning.tour_costs import EARLY_SHARE, TourCosts

MOVED_BY = 6
"""Number of positions by which the local search moves a short part of the tour."""


def exact_tour(costs: TourCosts, first: frozenset[int]) -> list[int]:
    """Return the postures of the best tour, by dynamic programming over the sets of visited viewpoints.

    Args:
        costs: Durations of the moves.
        first: Viewpoints that are visited before all others. Empty means any order.
    """
    groups = int(costs.group[-1]) + 1
    members = [np.flatnonzero(costs.group == g) for g in range(groups)]
    needed = sum(1 << g for g in first)
    later = 1 - EARLY_SHARE if first else 1.0
    size = len(costs.q)
    reached = np.full((1 << groups, size), np.inf)
    """Cost by the set of visited viewpoints and the last posture."""
    before = np.zeros((1 << groups, size), dtype=np.int64)
    for g in first or range(groups):
        reached[1 << g, members[g]] = costs.from_start[members[g]]
    for done in range(1, 1 << groups):
        complete = done & needed == needed
        if not complete and done & ~needed:
            continue
        inside = np.concatenate([members[g] for g in range(groups) if done >> g & 1])
        here = reached[done, inside] + (EARLY_SHARE * costs.to_home[inside] if done == needed else 0.0)
        onward = here[:, None] + (later if complete else 1.0) * costs.between[inside]
        cheapest = onward.argmin(axis=0)
        for g in range(groups) if complete else first:
            if not done >> g & 1:
                nodes = members[g]
                reached[done | 1 << g, nodes] = onward[cheapest[nodes], nodes]
                before[done | 1 << g, nodes] = inside[cheapest[nodes]]
    done = (1 << groups) - 1
    node = int((reached[done] + later * costs.to_home).argmin())
    result = [node]
    while done := done & ~(1 << int(costs.group[node])):
        node = int(before[done | 1 << int(costs.group[node]), node])
        result.append(node)
    return result[::-1]


def local_search(costs: TourCosts, first: frozenset[int], order: list[int]) -> tuple[list[int], list[int]]:
    """Return a tour that no rotation, reversal of a part, or move of a short part makes better.

    Args:
        costs: Durations of the moves.
        first: Viewpoints that are visited before all others. Empty means any order.
        order: Order of the viewpoints at the start of the search, with those of `first` first.

    Returns:
        The postures in order, and the order of their viewpoints.
    """
    layers = _Layers.of(costs, len(first))
    best = np.inf
    improved = True
    while improved:
        improved = False
        present = _Sweep.of(layers, order)
        best = min(best, present.cost(order))
        for candidate in _neighbours(order):
            if first and not first.issuperset(candidate[: len(first)]):
                continue
            if present.cost(candidate) < best - 1e-9:
                order, improved = candidate, True
                break
    return layers.cheapest(order), order


def _neighbours(order: list[int]) -> list[list[int]]:
    size = len(order)
    rolled = [order[i:] + order[:i] for i in range(1, size)]
    turned = [order[:i] + order[i:j][::-1] + order[j:] for i in range(size - 1) for j in range(i + 2, size + 1)]
    moved = []
    for length in (1, 2, 3):
        for i in range(size - length + 1):
            rest = order[:i] + order[i + length :]
            positions = range(max(i - MOVED_BY, 0), min(i + MOVED_BY, len(rest)) + 1)
            moved += [rest[:j] + order[i : i + length] + rest[j:] for j in positions if j != i]
    return rolled + turned + moved


@dataclass(frozen=True, eq=False)
class _Layers:
    """Durations sorted by viewpoint, to find the best postures for a given order."""

    members: list[NDArray[np.int64]]
    """Postures of each viewpoint."""
    start: list[NDArray[np.float64]]
    """Durations from the start to the postures of each viewpoint."""
    end: list[NDArray[np.float64]]
    """Durations from the postures of each viewpoint home."""
    between: list[list[NDArray[np.float64]]]
    """Durations (K, L) between the postures of two viewpoints."""
    first: int
    """Number of viewpoints that are visited first, or 0."""

    @staticmethod
    def of(costs: TourCosts, first: int) -> "_Layers":
        members = [np.flatnonzero(costs.group == g) for g in range(int(costs.group[-1]) + 1)]
        between = [[costs.between[np.ix_(a, b)] for b in members] for a in members]
        start, end = ([durations[m] for m in members] for durations in (costs.from_start, costs.to_home))
        return _Layers(members, start, end, between, first)

    def cheapest(self, order: list[int]) -> list[int]:
        """Return the postures of the cheapest tour in this order."""
        reached, choices = self.start[order[0]], []
        for count, (a, b) in enumerate(itertools.pairwise(order), 1):
            onward = self.onward(reached, count, a, b)
            choices.append(onward.argmin(axis=0))
            reached = onward.min(axis=0)
        choice = int(self.home(reached, order).argmin())
        nodes = [self.members[order[-1]][choice]]
        for group, cheapest in zip(order[-2::-1], choices[::-1], strict=True):
            choice = int(cheapest[choice])
            nodes.append(self.members[group][choice])
        return [int(node) for node in nodes[::-1]]

    def onward(self, reached: NDArray[np.float64], count: int, a: int, b: int) -> NDArray[np.float64]:
        """Return the costs (K, L) of the moves from `a`, the viewpoint number `count` of the tour, to `b`."""
        if count < self.first or not self.first:
            return reached[:, None] + self.between[a][b]
        if count == self.first:
            reached = reached + EARLY_SHARE * self.end[a]
        return reached[:, None] + (1 - EARLY_SHARE) * self.between[a][b]

    def home(self, reached: NDArray[np.float64], order: list[int]) -> NDArray[np.float64]:
        """Return the costs (K,) of the tours by their last posture, home included."""
        return reached + (1 - EARLY_SHARE if self.first else 1.0) * self.end[order[-1]]


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Costs along an order, from which those of similar orders follow soon."""

    layers: _Layers
    order: list[int]
    to: list[NDArray[np.float64]]
    """Cost of the best way to each posture of each viewpoint, by position in the order."""
    after: list[NDArray[np.float64]]
    """Cost of the best way from there to the end, home included."""

    @staticmethod
    def of(layers: _Layers, order: list[int]) -> "_Sweep":
        to = [layers.start[order[0]]]
        for count, (a, b) in enumerate(itertools.pairwise(order), 1):
            to.append(layers.onward(to[-1], count, a, b).min(axis=0))
        after = [layers.home(np.zeros(len(to[-1])), order)]
        for count in range(len(order) - 1, 0, -1):
            a, b = order[count - 1], order[count]
            step = layers.onward(np.zeros(len(layers.start[a])), count, a, b)
            after.append((step + after[-1]).min(axis=1))
        return _Sweep(layers, order, to, after[::-1])

    def cost(self, order: list[int]) -> float:
        """Return the cost of the cheapest tour in another order of the same viewpoints."""
        changed = [position for position, (a, b) in enumerate(zip(order, self.order, strict=True)) if a != b] or [0]
        # before the first changed position and after the last one, the costs are known
        begin, end = changed[0], min(changed[-1] + 1, len(order) - 1)
        is_last_changed = order[-1] != self.order[-1]
        reached = self.to[begin - 1] if begin else self.layers.start[order[0]]
        for count in range(max(begin, 1), end + 1):
            reached = self.layers.onward(reached, count, order[count - 1], order[count]).min(axis=0)
        return float((self.layers.home(reached, order) if is_last_changed else reached + self.after[end]).min())
