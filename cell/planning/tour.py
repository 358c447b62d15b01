"""Order of the viewpoints, and posture at each, with the least motion of the joints.

A few viewpoints are ordered exactly, by dynamic programming over the sets of visited viewpoints. Many are ordered by
local search; the postures are still chosen exactly.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.joint_paths import JointPath, PathFinder, travel_rad

EXACT_VIEWS = 10
"""Largest number of viewpoints that are ordered exactly. The number of sets doubles with each viewpoint."""
MOVED_BY = 6
"""Number of positions by which the local search moves a short part of the tour."""
MAX_ROUNDS = 40
"""Largest number of searches. A new search follows when a line of the tour is not free."""


@dataclass(frozen=True, eq=False)
class Tour:
    """A tour through all viewpoints."""

    stops: tuple[tuple[int, int], ...]
    """Viewpoint and posture of each stop, in order."""
    paths: tuple[JointPath, ...]
    """Joint path to each stop, then home."""


class _Costs:
    """Costs between postures, as far as known. A straight line counts as free until it is checked."""

    def __init__(
        self,
        start: NDArray[np.float64],
        home: NDArray[np.float64],
        groups: list[NDArray[np.float64]],
        path_finder: PathFinder,
        start_clearances: NDArray[np.float64],
    ) -> None:
        self.q = np.concatenate(groups)
        self.group = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
        self.between = np.abs(self.q[:, None] - self.q[None]).max(axis=2)
        self.from_start = np.abs(self.q - start).max(axis=1)
        self.to_home = np.abs(self.q - home).max(axis=1)
        self._start, self._path_finder, self._start_clearances = start, path_finder, start_clearances
        if path_finder.path_home(start, start_clearances) is None:
            self.from_start[~path_finder.are_free(start, self.q, start_clearances)] = np.inf

    def start_path(self, node: int) -> JointPath | None:
        if self._path_finder.is_free(self._start, self.q[node], self._start_clearances):
            return (self.q[node],)
        return self._path_finder.path_via_home(
            self._path_finder.path_home(self._start, self._start_clearances), self.q[node]
        )

    def check_lines(self, nodes: list[int]) -> bool:
        """Check the lines along these postures and correct their costs. Return whether all costs stayed the same."""
        before = self.of(nodes)
        first, last = nodes[0], nodes[-1]
        path = self.start_path(first)
        self.from_start[first] = np.inf if path is None else travel_rad(self._start, path)
        for a, b in itertools.pairwise(nodes):
            path = self._path_finder.path_between(self.q[a], self.q[b])
            self.between[a, b] = self.between[b, a] = np.inf if path is None else travel_rad(self.q[a], path)
        path = self._path_finder.path_home(self.q[last])
        self.to_home[last] = np.inf if path is None else travel_rad(self.q[last], path)
        return self.of(nodes) <= before + 1e-9

    def of(self, nodes: list[int]) -> float:
        inner = sum(self.between[a, b] for a, b in itertools.pairwise(nodes))
        return float(self.from_start[nodes[0]] + inner + self.to_home[nodes[-1]])


def find_tour(
    start: NDArray[np.float64],
    home: NDArray[np.float64],
    groups: list[NDArray[np.float64]],
    path_finder: PathFinder,
    start_clearances: NDArray[np.float64],
) -> Tour | None:
    """Return the tour with the least joint motion, or None if no path leads from the start.

    Lines that are not free are replaced by a path through the home posture.

    Args:
        start: Joint angles (6,) at the start.
        home: Joint angles (6,) of the home posture, to which a path leads from each posture.
        groups: Joint angles (K, 6) of the postures of each viewpoint, one of which is visited.
        path_finder: Finder of joint paths.
        start_clearances: Clearances (C,) on the line from the start, as in `PathFinder.is_free`.
    """
    if not groups:
        path = path_finder.path_home(start, start_clearances)
        return None if path is None else Tour((), (path,))
    costs = _Costs(start, home, groups, path_finder, start_clearances)
    best: list[int] = []
    order: list[int] = list(range(len(groups)))
    for _ in range(MAX_ROUNDS):
        if len(groups) <= EXACT_VIEWS:
            nodes = _exact_tour(costs, len(groups))
        else:
            nodes, order = _local_search(costs, order)
        settled = costs.check_lines(nodes)
        if not np.isfinite(costs.of(nodes)):
            return None
        if not best or costs.of(nodes) < costs.of(best):
            best = nodes
        if settled:
            break
    first_of = np.searchsorted(costs.group, np.arange(len(groups)))
    stops = tuple((int(costs.group[n]), int(n - first_of[costs.group[n]])) for n in best)
    paths = [costs.start_path(best[0])]
    paths += [path_finder.path_between(costs.q[a], costs.q[b]) for a, b in itertools.pairwise(best)]
    paths.append(path_finder.path_home(costs.q[best[-1]]))
    return Tour(stops, tuple(path for path in paths if path is not None))


def _exact_tour(costs: _Costs, groups: int) -> list[int]:
    """Return the cheapest tour as nodes."""
    members = [np.flatnonzero(costs.group == g) for g in range(groups)]
    size = len(costs.q)
    reached = np.full((1 << groups, size), np.inf)
    """Cost by the set of visited groups and the last node."""
    before = np.zeros((1 << groups, size), dtype=np.int64)
    for g, nodes in enumerate(members):
        reached[1 << g, nodes] = costs.from_start[nodes]
    for done in range(1, 1 << groups):
        inside = np.concatenate([members[g] for g in range(groups) if done >> g & 1])
        onward = reached[done, inside, None] + costs.between[inside]
        cheapest = onward.argmin(axis=0)
        for g, nodes in enumerate(members):
            if not done >> g & 1:
                reached[done | 1 << g, nodes] = onward[cheapest[nodes], nodes]
                before[done | 1 << g, nodes] = inside[cheapest[nodes]]
    done = (1 << groups) - 1
    node = int((reached[done] + costs.to_home).argmin())
    result = [node]
    while done := done & ~(1 << int(costs.group[node])):
        node = int(before[done | 1 << int(costs.group[node]), node])
        result.append(node)
    return result[::-1]


def _local_search(costs: _Costs, order: list[int]) -> tuple[list[int], list[int]]:
    """Return a tour that no rotation, reversal of a part, or move of a short part makes cheaper, and its order."""
    layers = _Layers.of(costs)
    best = layers.cost(order)
    improved = True
    while improved:
        improved = False
        for candidate in _neighbours(order):
            cost = layers.cost(candidate)
            if cost < best - 1e-9:
                best, order, improved = cost, candidate, True
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
    """Costs sorted by group, to find the cheapest postures for a given order."""

    members: list[NDArray[np.int64]]
    """Nodes of each group."""
    first: list[NDArray[np.float64]]
    """Costs from the start to the nodes of each group."""
    last: list[NDArray[np.float64]]
    """Costs from the nodes of each group home."""
    between: list[list[NDArray[np.float64]]]
    """Costs (K, L) between the nodes of two groups."""

    @staticmethod
    def of(costs: _Costs) -> "_Layers":
        members = [np.flatnonzero(costs.group == g) for g in range(int(costs.group[-1]) + 1)]
        between = [[costs.between[np.ix_(a, b)] for b in members] for a in members]
        return _Layers(members, [costs.from_start[m] for m in members], [costs.to_home[m] for m in members], between)

    def cost(self, order: list[int]) -> float:
        """Return the cost of the cheapest tour in this order."""
        reached = self.first[order[0]]
        for a, b in itertools.pairwise(order):
            reached = (reached[:, None] + self.between[a][b]).min(axis=0)
        return float((reached + self.last[order[-1]]).min())

    def cheapest(self, order: list[int]) -> list[int]:
        """Return the nodes of the cheapest tour in this order."""
        reached, choices = self.first[order[0]], []
        for a, b in itertools.pairwise(order):
            onward = reached[:, None] + self.between[a][b]
            choices.append(onward.argmin(axis=0))
            reached = onward.min(axis=0)
        choice = int((reached + self.last[order[-1]]).argmin())
        nodes = [self.members[order[-1]][choice]]
        for group, cheapest in zip(order[-2::-1], choices[::-1], strict=True):
            choice = int(cheapest[choice])
            nodes.append(self.members[group][choice])
        return [int(node) for node in nodes[::-1]]
