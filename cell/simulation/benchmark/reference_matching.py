"""Match thinned points in the literal baseline, by sections II.G, III.C and III.D of the paper, one point at a time."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Points = NDArray[np.float64]


def match_enhanced(
    points: Points, rates: NDArray[np.float64], parameters: ChainParameters
) -> tuple[list[list[int]], list[int]]:
    """Match thinned points by the enhanced method.

    Args:
        points: Thinned points (N, 3), metres.
        rates: Contribution rate (N,) of each point.
        parameters: Radii and thresholds of Table I.

    Returns:
        Indices of the linked points of each segment with at least two points, and indices of the bifurcation centre
        points.

    Source:
        Sections III.C and III.D.
    """
    from scipy.spatial import KDTree

    search = _Search(points, KDTree(points), rates < parameters.rho_t, np.ones(len(points), dtype=bool), parameters)
    while search.connectable.any():
        search.start(int(np.flatnonzero(search.connectable)[0]))
        while search.restarts:
            search.grow(search.restarts.pop())
    return [segment for segment in search.segments if len(segment) > 1], search.centres


@dataclass
class _Search:
    """State of the matching. Points are given by their indices."""

    points: Points
    """Thinned points (N, 3), metres."""
    tree: "KDTree"
    """Search tree of the points."""
    intersection: NDArray[np.bool_]
    """Whether each point (N,) belongs to an intersection (III.C)."""
    connectable: NDArray[np.bool_]
    """Whether each point (N,) can still be linked."""
    parameters: ChainParameters
    """Radii and thresholds of Table I."""
    segments: list[list[int]] = field(default_factory=list)
    """Linked points of each finished segment."""
    centres: list[int] = field(default_factory=list)
    """Bifurcation centre points."""
    restarts: list[list[int]] = field(default_factory=list)
    """First points of each segment that still has to grow from a bifurcation."""

    def start(self, point: int) -> None:
        """Grow a sequence from a start point."""
        self.eliminate(point, self.parameters.r_n)
        self.grow([point])

    def grow(self, sequence: list[int]) -> None:
        """Extend the sequence (II.G) until its end or until an intersection, and store the segment."""
        while self.rate(sequence[-1]) <= self.parameters.R_t:
            next_point = self.link(sequence[-1])
            if next_point is None:
                self.segments.append(sequence)
                return
            sequence.append(next_point)
        # The first point inside the intersection is not part of the segment.
        self.segments.append(sequence[:-1])
        self.bifurcate(sequence[-1])

    def bifurcate(self, inside: int) -> None:
        """Find the bifurcation centre from the first point inside an intersection, and the restarts (III.D)."""
        path, rates = [inside], [self.rate(inside)]
        while rates[-1] == max(rates) and (next_point := self.link(path[-1])) is not None:
            path.append(next_point)
            rates.append(self.rate(next_point))
        # Several points in the middle of an intersection may share the largest rate.
        greatest = [point for point, rate in zip(path, rates, strict=True) if rate == max(rates)]
        centre = greatest[len(greatest) // 2]
        self.centres.append(centre)
        self.eliminate(centre, self.parameters.r_cn)
        while (restart := self.nearest(centre, self.parameters.r_cf)) is not None:
            self.eliminate(restart, self.parameters.r_n)
            next_point = self.link(restart)
            if next_point is not None:
                self.restarts.append([restart, next_point])

    def link(self, point: int) -> int | None:
        """Return the nearest connectable point within r_f as the next target, or None (II.G, steps 3 to 5)."""
        next_point = self.nearest(point, self.parameters.r_f)
        if next_point is not None:
            self.eliminate(next_point, self.parameters.r_n)
        return next_point

    def rate(self, point: int) -> float:
        """Return the rate of intersection points R_c around a point, eq. (7)."""
        neighbours = self.tree.query_ball_point(self.points[point], self.parameters.r_f)
        return float(self.intersection[neighbours].mean())

    def nearest(self, point: int, radius_m: float) -> int | None:
        """Return the nearest connectable point within a sphere around a point, or None without one."""
        neighbours = [j for j in self.tree.query_ball_point(self.points[point], radius_m) if self.connectable[j]]
        if not neighbours:
            return None
        return min(neighbours, key=lambda j: float(np.linalg.norm(self.points[j] - self.points[point])))

    def eliminate(self, point: int, radius_m: float) -> None:
        """Mark the points within a sphere around a point as not connectable."""
        self.connectable[self.tree.query_ball_point(self.points[point], radius_m)] = False
