"""The literal baseline's matching: sections II.G, III.C and III.D of the paper, point by point with a KD-tree."""

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
    """Enhanced matching (III.C, III.D) of thinned points (N, 3) with their contribution rates (N,).

    Returns the segments as numbers of linked points, and the bifurcation centre points.
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
    """Points that belong to an intersection (III.C)."""
    connectable: NDArray[np.bool_]
    parameters: ChainParameters
    segments: list[list[int]] = field(default_factory=list)
    centres: list[int] = field(default_factory=list)
    restarts: list[list[int]] = field(default_factory=list)

    def start(self, point: int) -> None:
        """A sequence begun anywhere."""
        self.eliminate(point, self.parameters.r_n)
        self.grow([point])

    def grow(self, sequence: list[int]) -> None:
        """The sequence continued by the matching method (II.G) until its end or an intersection."""
        while self.rate(sequence[-1]) <= self.parameters.R_t:
            following = self.link(sequence[-1])
            if following is None:
                self.segments.append(sequence)
                return
            sequence.append(following)
        # The point before the first inside is the segment's end.
        self.segments.append(sequence[:-1])
        self.bifurcate(sequence[-1])

    def bifurcate(self, inside: int) -> None:
        """Bifurcated restart (III.D) from the first point found inside an intersection."""
        path, rates = [inside], [self.rate(inside)]
        while rates[-1] == max(rates) and (following := self.link(path[-1])) is not None:
            path.append(following)
            rates.append(self.rate(following))
        # All of an intersection's middle may have the same greatest rate.
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
        """The nearest connectable point within r_f (II.G 3 to 5), which becomes the next target."""
        following = self.nearest(point, self.parameters.r_f)
        if following is not None:
            self.eliminate(following, self.parameters.r_n)
        return following

    def rate(self, point: int) -> float:
        """R_c, eq. (7)."""
        around = self.tree.query_ball_point(self.points[point], self.parameters.r_f)
        return float(self.intersection[around].mean())

    def nearest(self, point: int, radius_m: float) -> int | None:
        """The nearest connectable point within a sphere about a point."""
        around = [j for j in self.tree.query_ball_point(self.points[point], radius_m) if self.connectable[j]]
        if not around:
            return None
        return min(around, key=lambda j: float(np.linalg.norm(self.points[j] - self.points[point])))

    def eliminate(self, point: int, radius_m: float) -> None:
        """Makes the points within a sphere about a point unconnectable."""
        self.connectable[self.tree.query_ball_point(self.points[point], radius_m)] = False
