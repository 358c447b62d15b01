"""Matching method (section II.G): link the points of a thin line in order, by a search with two spheres."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters

Segment = list[int]
"""Indices of linked points, in order."""


@dataclass(eq=False)
class SearchField:
    """Point cloud of a search. The points that the search has passed become unconnectable.

    Source:
        Section II.G.
    """

    points: NDArray[np.float64]
    """(N, 3) points, metres."""
    connectable: NDArray[np.bool_] = field(init=False)
    """(N,) mask, True for the points that may still be linked."""
    tree: KDTree = field(init=False, repr=False)
    """Search tree of `points`."""

    def __post_init__(self) -> None:
        self.points = np.asarray(self.points, dtype=np.float64).reshape(-1, 3)
        self.connectable = np.ones(len(self.points), dtype=bool)
        self.tree = KDTree(self.points)

    def eliminate(self, centre: NDArray[np.float64], radius: float) -> None:
        """Make all points within `radius` of `centre` (3,) unconnectable (step 2)."""
        self.connectable[self.tree.query_ball_point(centre, radius)] = False

    def connectable_within(self, centre: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
        """Return the indices of the connectable points within `radius` of `centre` (3,), ascending."""
        near = np.asarray(self.tree.query_ball_point(centre, radius, return_sorted=True), dtype=np.int64)
        return near[self.connectable[near]]

    def nearest_connectable(self, centre: NDArray[np.float64], radius: float) -> int | None:
        """Return the index of the nearest connectable point within `radius` of `centre` (3,), if any (steps 3, 4)."""
        near = self.connectable_within(centre, radius)
        if len(near) == 0:
            return None
        return int(near[np.linalg.norm(self.points[near] - centre, axis=1).argmin()])


def next_point(search: SearchField, target: int, parameters: ChainParameters) -> int | None:
    """Eliminate the points around a target point, and return the index of the next point.

    Args:
        search: Point cloud. Points within r_n of the target become unconnectable.
        target: Index of the target point.
        parameters: Method parameters; uses the radii r_n and r_f of the search spheres.

    Returns:
        The index of the nearest connectable point within r_f of the target, or None if no point is connectable there.

    Source:
        Section II.G, steps 1 to 5.
    """
    centre = search.points[target]
    search.eliminate(centre, parameters.r_n)
    return search.nearest_connectable(centre, parameters.r_f)


def starting_order(search: SearchField, radius: float) -> NDArray[np.int64]:
    """Return the points in the order in which sequences start: the points with the fewest neighbours first.

    A point at the end of a line has half as many neighbours as a point in the middle. A sequence that starts at an end
    follows the string to the other end without a break.

    Args:
        search: Point cloud with N points.
        radius: Radius of the neighbourhoods, metres.

    Returns:
        (N,) indices of the points.

    Source:
        Not in the paper, which does not say where a sequence starts.
    """
    if len(search.points) == 0:
        return np.empty(0, dtype=np.int64)
    n_neighbours = search.tree.query_ball_point(search.points, radius, return_length=True)
    return np.argsort(n_neighbours, kind="stable")


def match_points(points: NDArray[np.float64], parameters: ChainParameters) -> list[Segment]:
    """Link the points to segments by the matching method, until no connectable point is left.

    Args:
        points: (N, 3) points of the centre line, metres.
        parameters: Method parameters; uses the radii r_n and r_f of the search spheres.

    Returns:
        The segments, as indices into `points`. A segment may have a single point.

    Source:
        Section II.G. The order of the starting points is not in the paper (see `starting_order`).
    """
    search = SearchField(points)
    segments = []
    for start in starting_order(search, parameters.r_f):
        if not search.connectable[start]:
            continue
        segment = [int(start)]
        while (linked := next_point(search, segment[-1], parameters)) is not None:
            segment.append(linked)
        segments.append(segment)
    return segments
