"""Height map of the measured surface: whether another strand lies over a point, and whether the table is bare there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

MIN_ABOVE_RADII = 1.5
"""Surface that is higher above a point than this, in radii, belongs to another strand.

The top of a strand is 1 r above its own centre line. The top of another strand on it is at least 2.2 r above that line.
"""
SEARCH_RADII = 0.8
"""Horizontal distance from a point within which the surface is examined, in radii."""
MIN_OCCLUDED_SHARE = 0.1
"""A point is occluded if more than this share of the surface near it is high. A single high point is noise."""


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Occluded points and points over bare table, seen from above."""

    is_occluded: NDArray[np.bool_]
    """(N,) whether another strand lies over the point."""
    is_bare: NDArray[np.bool_]
    """(N,) whether there is no surface at the point: the table is bare there."""


class HeightMap:
    """Surface seen from above.

    Args:
        surface: (M, 3) registered surface points, metres, base frame.
    """

    def __init__(self, surface: NDArray[np.float64]) -> None:
        self.surface = surface
        self._tree = KDTree(surface[:, :2])

    def occlusion(self, points: NDArray[np.float64], r: float) -> Occlusion:
        """Return which points of a string are under another strand, and which are over bare table.

        Args:
            points: (N, 3) points of the string's centre line, metres, base frame.
            r: Radius of the string, metres.

        Returns:
            Two masks of the points. Both are False where only the string itself was measured.

        Source:
            Ours.
        """
        pairs = KDTree(points[:, :2]).sparse_distance_matrix(self._tree, SEARCH_RADII * r, output_type="ndarray")
        row, column = pairs["i"], pairs["j"]
        counts = np.bincount(row, minlength=len(points))
        is_high = self.surface[column, 2] > points[row, 2] + MIN_ABOVE_RADII * r
        is_occluded = np.bincount(row, is_high, len(points)) > MIN_OCCLUDED_SHARE * np.maximum(counts, 1)
        return Occlusion(is_occluded, is_bare=counts == 0)
