"""Matching of the literal baseline, sections II.G, III.C and III.D of the paper, point by point with a KD-tree."""

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
    """Match thinned points by the enhanced method (III.C, III.D).

    Args:
        points: Thinned points (N, 3).
        rates: Contribution rates (N,).
        parameters: Parameters of the paper.

    Returns:
        Segments as indices of linked points, and the bifurcation centre points.
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
    points: Points
    tree: "KDTree"
    intersection: NDArray[np.bool_]
    """Whether each point belongs to an intersection (III.C)."""
    connectable: NDArray[np.bool_]
    parameters: ChainParameters
    segments: list[list[int]] = field(default_factory=list)
    centres: list[int] = field(default_factory=list)
    restarts: list[list[int]] = field(default_factory=list)

    def start(self, point: int) -> None:
        """Return a sequence that starts at a point."""
        self.eliminate(point, self.parameters.r_n)
        self.grow([point])

    def grow(self, sequence: list[int]) -> None:
        """Continue the sequence by the matching method (II.G) to its end or to an intersection."""
        while self.rate(sequence[-1]) <= self.parameters.R_t:
            following = self.link(sequence[-1])
            if following is None:
                self.segments.append(sequence)
                return
            sequence.append(following)
        # the segment ends before the first point inside
        self.segments.append(sequence[:-1])
        self.bifurcate(sequence[-1])

    def bifurcate(self, inside: int) -> None:
        """Restart at a bifurcation (III.D) from the first point inside an intersection."""
        path, rates = [inside], [self.rate(inside)]
        while rates[-1] == max(rates) and (following := self.link(path[-1])) is not None:
            path.append(following)
            rates.append(self.rate(following))
        # several points in the middle of an intersection may have the largest rate
        greatest = [point for point, rate in zip(path, rates, strict=True) if rate == max(rates)]
        centre = greatest[len(greatest) // 2]
        self.centres.append(centre)
        self.eliminate(centre, self.parameters.r_cn)
        while (restart := self.nearest(centre, self.parameters.r_cf)) is not None:
            self.eliminate(restart, self.parameters.r_n)
            following = self.link(restart)
            if following is not None:
                self.restarts.append([restart, following])

    def link(self, point: int) -> int | None:
        """Return the nearest connectable point within r_f (II.G 3 to 5), which becomes the next target."""
        following = self.nearest(point, self.parameters.r_f)
        if following is not None:
            self.eliminate(following, self.parameters.r_n)
        return following

    def rate(self, point: int) -> float:
        """Return R_c, eq. (7)."""
        around = self.tree.query_ball_point(self.points[point], self.parameters.r_f)
        return float(self.intersection[around].mean())

    def nearest(self, point: int, radius_m: float) -> int | None:
        """Return the nearest connectable point within a sphere around a point."""
        around = [j for j in self.tree.query_ball_point(self.points[point], radius_m) if self.connectable[j]]
        if not around:
            return None
        return min(around, key=lambda j: float(np.linalg.norm(self.points[j] - self.points[point])))

    def eliminate(self, point: int, radius_m: float) -> None:
        """Make the points within a sphere around a point unconnectable."""
        self.connectable[self.tree.query_ball_point(self.points[point], radius_m)] = False
