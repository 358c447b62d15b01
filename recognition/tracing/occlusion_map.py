"""Occlusion map of the measured surface: shows where another strand hides a point and where the table is bare."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import pairs_between
from recognition.preprocessing.lines_of_sight import ViewCounts, count_views, depths_at
from recognition.preprocessing.normals import NormalCloud

MIN_ABOVE_RADII = 1.5
"""Minimum height of another strand's surface above a point of the centre line, in radii r.

The top of a strand is 1 r above its own centre line. The top of an over strand is at least 2.2 r above this line.
"""
SEARCH_RADII = 0.8
"""Maximum horizontal distance between a point and the surface that is examined, in radii r."""
MIN_OCCLUDED_SHARE = 0.1
"""Minimum share of high points in the surface near an occluded point. With a smaller share, these points are noise."""
MIN_BEFORE_RADII = 1.5
"""Minimum distance, along the line of sight, of the surface that hides a point of the centre line from a view, in radii
r. The surface of the point's own strand is 1 r before it."""


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Masks of the points that are occluded and of the points over bare table."""

    is_occluded: NDArray[np.bool_]
    """(N,) mask, True where another strand lies over the point, or hides it from all views."""
    is_uncovered: NDArray[np.bool_]
    """(N,) mask, True where no surface above the table was measured near the point, and a view could have measured it.
    The table is taken to be bare."""


class OcclusionMap:
    """Measured surface above the table, seen from above and from the cameras.

    Args:
        surface: (M, 3) registered surface points, metres, base frame.
        views: Registered views. A single oblique view does not show what is behind a strand. Without views, only what
            lies under a strand is occluded.
    """

    def __init__(self, surface: NDArray[np.float64], views: Sequence[NormalCloud] = ()) -> None:
        self.surface = surface
        self._views = views
        self._tree = KDTree(surface[:, :2])

    def occlusion(self, points: NDArray[np.float64], r: float) -> Occlusion:
        """Return which points of a centre line another strand hides, and which lie over bare table.

        Args:
            points: (N, 3) points of the centre line, metres, base frame.
            r: Radius of the string, metres.

        Returns:
            The masks `is_occluded` and `is_uncovered`. They are False where the string itself is the top surface.
        """
        row, column = pairs_between(KDTree(points[:, :2]), self._tree, SEARCH_RADII * r)
        counts = np.bincount(row, minlength=len(points))
        is_high = self.surface[column, 2] > points[row, 2] + MIN_ABOVE_RADII * r
        is_occluded = np.bincount(row, is_high, len(points)) > MIN_OCCLUDED_SHARE * np.maximum(counts, 1)
        is_hidden = self._is_hidden(points, r)
        return Occlusion(is_occluded | is_hidden, is_uncovered=(counts == 0) & ~is_hidden)

    def views_through(self, points: NDArray[np.float64], r: float) -> ViewCounts:
        """Return how many views look through points (N, 3) of a centre line, and how many a string may have stopped."""
        return count_views(points, r, self._views)

    def _is_hidden(self, points: NDArray[np.float64], r: float) -> NDArray[np.bool_]:
        """Return the mask (N,) of the points that every view measured something before. Without views, it is False."""
        is_hidden = np.full(len(points), len(self._views) > 0)
        for view in self._views:
            if not is_hidden.any():
                break
            is_hidden[is_hidden] = _is_hidden_from(view, points[is_hidden], MIN_BEFORE_RADII * r)
        return is_hidden


def _is_hidden_from(view: NormalCloud, points: NDArray[np.float64], min_before_m: float) -> NDArray[np.bool_]:
    """Return the mask (N,) of the points that have measured surface before them in a view."""
    if view.image is None or view.T_base_camera is None:
        return np.zeros(len(points), dtype=np.bool_)
    depths = depths_at(points, view.image, view.T_base_camera)
    return (depths.measured_m > 0) & (depths.measured_m < depths.own_m - min_before_m)
