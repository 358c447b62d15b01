"""Occlusion map of the measured surface: shows where another strand lies over a point and where the table is bare."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

MIN_ABOVE_RADII = 1.5
"""Minimum height of another strand's surface above a point of the centre line, in radii r.

The top of a strand is 1 r above its own centre line. The top of an over strand is at least 2.2 r above this line.
"""
SEARCH_RADII = 0.8
"""Maximum horizontal distance between a point and the surface that is examined, in radii r."""
MIN_OCCLUDED_SHARE = 0.1
"""Minimum share of high points in the surface near an occluded point. With a smaller share, these points are noise."""


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Masks of the points that are occluded and of the points over bare table, seen from above."""

    is_occluded: NDArray[np.bool_]
    """(N,) mask, True where another strand lies over the point."""
    is_uncovered: NDArray[np.bool_]
    """(N,) mask, True where no surface above the table was measured near the point. The table is taken to be bare."""


class OcclusionMap:
    """Measured surface above the table, seen from above.

    Args:
        surface: (M, 3) registered surface points, metres, base frame.
    """

    def __init__(self, surface: NDArray[np.float64]) -> None:
        self.surface = surface
        self._tree = KDTree(surface[:, :2])

    def occlusion(self, points: NDArray[np.float64], r: float) -> Occlusion:
        """Return which points of a centre line lie under another strand, and which lie over bare table.

        Args:
            points: (N, 3) points of the centre line, metres, base frame.
            r: Radius of the string, metres.

        Returns:
            The masks `is_occluded` and `is_uncovered`. They are False where the string itself is the top surface.
        """
        pairs = KDTree(points[:, :2]).sparse_distance_matrix(self._tree, SEARCH_RADII * r, output_type="ndarray")
        row, column = pairs["i"], pairs["j"]
        counts = np.bincount(row, minlength=len(points))
        is_high = self.surface[column, 2] > points[row, 2] + MIN_ABOVE_RADII * r
        is_occluded = np.bincount(row, is_high, len(points)) > MIN_OCCLUDED_SHARE * np.maximum(counts, 1)
        return Occlusion(is_occluded, is_uncovered=counts == 0)
