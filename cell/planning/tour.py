"""Order of the viewpoints, and posture at each, with the least duration of the arm's motion.

A few viewpoints are ordered exactly. Many are ordered by local search; the postures are still chosen exactly.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.joint_paths import JointPath
from cell.planning.tour_costs import Postures, TourCosts
from cell.planning.tour_search import exact_tour, local_search

EXACT_VIEWS = 10
"""Largest number of viewpoints that are ordered exactly. The number of sets doubles with each viewpoint."""
MAX_ROUNDS = 40
"""Largest number of searches. A new search follows when a line of the tour is not free."""


@dataclass(frozen=True, eq=False)
class Tour:
    """A tour through all viewpoints."""

    stops: tuple[tuple[int, int], ...]
    """Viewpoint and posture of each stop, in order."""
    paths: tuple[JointPath, ...]
    """Joint path to each stop, then home."""
    home_paths: tuple[JointPath, ...]
    """Joint path from each stop home."""
    first: int
    """Number of stops at the viewpoints that are visited first. 0 if none are."""


def find_tour(
    postures: Postures,
    start: NDArray[np.float64],
    start_clearances: NDArray[np.float64],
    first: Sequence[Collection[int]] = (),
) -> Tour | None:
    """Return the tour of the least duration, or None if no path leads from the start.

    Lines that are not free are replaced by a path through the home posture.

    Args:
        postures: Postures of the viewpoints.
        start: Joint angles (6,) at the start.
        start_clearances: Clearances (C,) on the line from the start, as in `PathFinder.is_free`.
        first: Alternative sets of viewpoints. The tour visits all of one set before any other viewpoint, and has the
            least expected duration if `EARLY_SHARE` of the scans end after that set.
    """
    costs = TourCosts(postures, start, start_clearances)
    if not len(costs.q):
        path = costs.home_path_of_start()
        return None if path is None else Tour((), (path,), (), 0)
    if not np.isfinite(costs.from_start).any():
        return None
    groups = int(costs.group[-1]) + 1
    alternatives = [frozenset(views) for views in first] or [frozenset()]
    orders = {views: [*sorted(views), *sorted(set(range(groups)) - views)] for views in alternatives}
    best: list[int] = []
    best_first = 0
    for _ in range(MAX_ROUNDS):
        found: list[tuple[list[int], int]] = []
        for views in alternatives:
            # if all viewpoints are first, none is later
            ordered = views if len(views) < groups else frozenset[int]()
            if groups <= EXACT_VIEWS:
                nodes = exact_tour(costs, ordered)
            else:
                nodes, orders[views] = local_search(costs, ordered, orders[views])
            found.append((nodes, len(views)))
        nodes, count = min(found, key=lambda each: costs.expected_s(*each))
        settled = costs.check_lines(nodes, count)
        if not best or costs.expected_s(nodes, count) < costs.expected_s(best, best_first):
            best, best_first = nodes, count
        if settled:
            break
    return _tour(costs, best, best_first)


def _tour(costs: TourCosts, nodes: list[int], first: int) -> Tour:
    first_of = np.searchsorted(costs.group, costs.group[nodes])
    stops = tuple(zip(costs.group[nodes].tolist(), (nodes - first_of).tolist(), strict=True))
    home_paths = [costs.home_path(node) for node in nodes]
    paths = [costs.start_path(nodes[0])]
    paths += [costs.path_between(a, b) for a, b in itertools.pairwise(nodes)]
    paths.append(home_paths[-1])
    known, known_home = ([path for path in each if path is not None] for each in (paths, home_paths))
    # a path leads home from each posture, so one leads to every other
    assert len(known) == len(nodes) + 1
    assert len(known_home) == len(nodes)
    return Tour(stops, tuple(known), tuple(known_home), first)
