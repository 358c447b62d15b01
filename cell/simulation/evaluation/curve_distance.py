"""Polylines with evenly spaced points, and distances from polylines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, points_at

DENSE_SPACING_M = 0.0005
"""Approximate spacing of the points of a dense polyline, metres."""

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Polyline:
    """Polyline, open or closed."""

    points: Points
    """Points (N, 3), metres, at least two. The last point of a closed line equals its first point."""
    closed: bool = False
    """Whether the line is a closed loop."""

    @classmethod
    def of(cls, points: Points, closed: bool) -> "Polyline":
        """Return the line through `points` (N, 3).

        If `closed` is true and the last point differs from the first point, the first point is appended.
        """
        if closed and not np.array_equal(points[0], points[-1]):
            points = np.vstack([points, points[:1]])
        return cls(points, closed)

    @property
    def length_m(self) -> float:
        """Length of the line, metres. The length of a closed line includes the closing segment."""
        return float(arc_length(self.points)[-1])

    def at_shares(self, shares: NDArray[np.float64]) -> Points:
        """Return the points (M, 3) at `shares` (M,) of the length, 0 to 1."""
        return points_at(self.points, shares * self.length_m)

    def evenly_spaced(self, count: int) -> Points:
        """Return evenly spaced points (count, 3).

        The points of an open line include both ends. The points of a closed line begin at its first point and do not
        repeat it.
        """
        return self.at_shares(np.linspace(0.0, 1.0, count, endpoint=not self.closed))

    def densely_sampled(self) -> Points:
        """Return evenly spaced points (M, 3) about `DENSE_SPACING_M` apart, including both ends."""
        return self.at_shares(np.linspace(0.0, 1.0, max(round(self.length_m / DENSE_SPACING_M), 2) + 1))


class NearestPoints:
    """Search for the nearest points on a set of at least one line.

    Each line is sampled densely. The search finds the nearest sample, and then the nearest point on the two segments at
    this sample. The sample alone would be off by up to half of the spacing.
    """

    def __init__(self, lines: Sequence[Polyline]) -> None:
        from scipy.spatial import KDTree

        samples = [line.densely_sampled() for line in lines]
        self._samples = np.vstack(samples)
        self._tree = KDTree(self._samples)
        # Indices of the previous and the next sample on the same line. An end of an open line is its own neighbour. The
        # first and the last sample of a closed line coincide.
        number = np.arange(len(self._samples))
        bounds = np.cumsum([0, *(len(points) for points in samples)])
        first, last = bounds[:-1], bounds[1:] - 1
        closed = np.array([line.closed for line in lines])
        self._previous, self._next = number - 1, number + 1
        self._previous[first] = np.where(closed, last - 1, first)
        self._next[last] = np.where(closed, first + 1, last)

    def points(self, points: Points) -> Points:
        """Return the point on the lines (M, 3) that is nearest to each of `points` (M, 3)."""
        nearest = self._tree.query(points)[1]
        sample = self._samples[nearest]
        candidates = [_on_segments(points, sample, self._samples[end[nearest]]) for end in (self._previous, self._next)]
        distances = [np.linalg.norm(points - candidate, axis=1) for candidate in candidates]
        return np.where((distances[0] < distances[1])[:, None], candidates[0], candidates[1])

    def distance(self, points: Points) -> NDArray[np.float64]:
        """Return the distance (M,) of each of `points` (M, 3) from the lines, metres."""
        return np.linalg.norm(points - self.points(points), axis=1)


def _on_segments(points: Points, start: Points, end: Points) -> Points:
    """Return the nearest point (M, 3) on each segment from `start` to `end` (M, 3). The two may coincide."""
    along = end - start
    squared = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", points - start, along) / np.where(squared > 0, squared, 1.0)
    return start + np.clip(share, 0.0, 1.0)[:, None] * along
