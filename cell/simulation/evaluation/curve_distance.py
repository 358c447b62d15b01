"""Centre lines with even samples, and exact distances from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, points_at

DENSE_M = 0.0005
"""Distance of the samples of a dense polyline."""

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Line:
    """A polyline. The last point of a closed one is its first."""

    points: Points
    """Points (N, 3), at least two."""
    closed: bool = False

    @classmethod
    def of(cls, points: Points, closed: bool) -> "Line":
        """Return the line through `points` (N, 3). A closed line may or may not repeat its first point."""
        if closed and not np.array_equal(points[0], points[-1]):
            points = np.vstack([points, points[:1]])
        return cls(points, closed)

    @property
    def length_m(self) -> float:
        """Length of the line, around the whole loop if it is closed."""
        return float(arc_length(self.points)[-1])

    def at_shares(self, shares: NDArray[np.float64]) -> Points:
        """Return the points (M, 3) at shares (M,) of the length, from 0 to 1."""
        return points_at(self.points, shares * self.length_m)

    def even(self, count: int) -> Points:
        """Return evenly spaced points (count, 3), from end to end, or around the loop without repeating the first."""
        return self.at_shares(np.linspace(0.0, 1.0, count, endpoint=not self.closed))

    def dense(self) -> Points:
        """Return points (M, 3) about `DENSE_M` apart, with both ends."""
        return self.at_shares(np.linspace(0.0, 1.0, max(round(self.length_m / DENSE_M), 2) + 1))


class Nearest:
    """Nearest points on a set of at least one line, exact on the dense polylines.

    With samples alone, two equal lines would differ by up to half a sampling step.
    """

    def __init__(self, lines: Sequence[Line]) -> None:
        from scipy.spatial import KDTree

        dense = [line.dense() for line in lines]
        self._samples = np.vstack(dense)
        self._tree = KDTree(self._samples)
        # neighbours of each sample along its own line; the ends of an open line have one neighbour, and those of a
        # closed line coincide
        number = np.arange(len(self._samples))
        ends = np.cumsum([0, *(len(points) for points in dense)])
        first, last = ends[:-1], ends[1:] - 1
        closed = np.array([line.closed for line in lines])
        self._before, self._after = number - 1, number + 1
        self._before[first] = np.where(closed, last - 1, first)
        self._after[last] = np.where(closed, first + 1, last)

    def points(self, points: Points) -> Points:
        """Return the nearest point on the lines (M, 3) for each of `points` (M, 3)."""
        nearest = self._tree.query(points)[1]
        sample = self._samples[nearest]
        candidates = [_on_segments(points, sample, self._samples[end[nearest]]) for end in (self._before, self._after)]
        apart = [np.linalg.norm(points - candidate, axis=1) for candidate in candidates]
        return np.where((apart[0] < apart[1])[:, None], candidates[0], candidates[1])

    def distance(self, points: Points) -> NDArray[np.float64]:
        """Return the distances (M,) of `points` (M, 3) from the lines."""
        return np.linalg.norm(points - self.points(points), axis=1)


def _on_segments(points: Points, start: Points, end: Points) -> Points:
    """Return the nearest point (M, 3) on each segment from `start` to `end`. A segment may be a point."""
    along = end - start
    squared = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", points - start, along) / np.where(squared > 0, squared, 1.0)
    return start + np.clip(share, 0.0, 1.0)[:, None] * along
