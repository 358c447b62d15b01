"""Matching method (section II.G): points of a thin line linked in order by a double sphere search."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters

Segment = list[int]
"""Indices of linked points, in order."""


@dataclass(eq=False)
class SearchField:
    """A point cloud in which points stop being connectable as the search passes them."""

    points: NDArray[np.float64]
    """(N, 3)."""
    connectable: NDArray[np.bool_] = field(init=False)
    """(N,), which points may still be linked to."""
    tree: KDTree = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.points = np.asarray(self.points, dtype=np.float64).reshape(-1, 3)
        self.connectable = np.ones(len(self.points), dtype=bool)
        self.tree = KDTree(self.points)

    def eliminate(self, centre: NDArray[np.float64], radius: float) -> None:
        """Makes all points within `radius` of `centre` unconnectable (step 2)."""
        self.connectable[self.tree.query_ball_point(centre, radius)] = False

    def connectable_within(self, centre: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
        """Indices of the connectable points within `radius` of `centre`."""
        near = np.asarray(self.tree.query_ball_point(centre, radius, return_sorted=True), dtype=np.int64)
        return near[self.connectable[near]]

    def nearest_connectable(self, centre: NDArray[np.float64], radius: float) -> int | None:
        """The nearest connectable point within `radius` of `centre`, None when there is none (steps 3 and 4)."""
        near = self.connectable_within(centre, radius)
        if len(near) == 0:
            return None
        return int(near[np.linalg.norm(self.points[near] - centre, axis=1).argmin()])


def next_point(search: SearchField, target: int, parameters: ChainParameters) -> int | None:
    """From one target point to the next: steps 1 to 5. None when there is nothing left to link to."""
    centre = search.points[target]
    search.eliminate(centre, parameters.r_n)
    return search.nearest_connectable(centre, parameters.r_f)


def starting_order(search: SearchField, radius: float) -> NDArray[np.int64]:
    """(N,) the points in the order in which sequences start from them: those with fewest neighbours first.

    The paper leaves the start open. A line's ends have half the neighbours of its middle, so starting there
    follows a string from end to end in one piece.
    """
    if len(search.points) == 0:
        return np.empty(0, dtype=np.int64)
    neighbours = search.tree.query_ball_point(search.points, radius, return_length=True)
    return np.argsort(neighbours, kind="stable")


def match_points(points: NDArray[np.float64], parameters: ChainParameters) -> list[Segment]:
    """Segments of linked points (indices into `points` (N, 3)), until no point is connectable any more."""
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
