"""Fragments that are visible parts of strings: what they hide, what touches them, and what runs along them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.intersections import planar_cross
from recognition.geometry.neighbours import pairs_between
from recognition.geometry.polyline import arc_length, resample, unit_vectors
from recognition.tracing.fragments import Fragment

STEP_RADII = 0.5
"""Spacing of the points along the fragments, in radii r."""
BESIDE_RADII = 2.5
"""Maximum distance of the surface that is examined beside a fragment, in radii r."""
ON_TUBE_RADII = 0.5
"""Maximum distance of surface from the tube of a fragment to which it belongs, in radii r."""
MIN_TUBE_SHARE = 0.88
"""Minimum share of the surface beside a fragment that lies on its tube. Otherwise the fragment is no visible string.

Fragments of strings have at least 0.9, also in tight knots. Edges and folds of objects continue as a surface.
"""
OVER_RADII = 1.3
"""Maximum horizontal distance of a hidden point from the line of the strand that hides it, in radii r."""
MIN_OVER_RADII = 2.2
"""Minimum height of a strand that hides another one, in radii r. Below a height of 3 r, both overlap in contact."""
MAX_DROP_RADII = 0.5
"""Maximum height of the lower end of a hidden curve above the strand that hides it, in radii r."""
OWN_RADII = 4.0
"""Length of a fragment at its end that cannot hide the continuation of this end, in radii r."""
TOUCHING_RADII = 2.5
"""Maximum distance of the line of another strand around which a string bends, in radii r."""
MIN_ALONG_COSINE = np.cos(np.radians(25))
"""Minimum cosine between the directions of two strands one of which runs along the other one (25 degrees)."""

Points = NDArray[np.float64]
Indices = NDArray[np.int64]


class VisibleStrings:
    """The fragments that are visible parts of strings, and what they hide.

    Args:
        fragments: Fragments of the scene.
        surface: (M, 3) registered surface points, metres, base frame.
        r: Radius of the string, metres.
        table_z_m: Height of the table, metres, base frame.
    """

    def __init__(self, fragments: Sequence[Fragment], surface: Points, r: float, table_z_m: float = 0.0) -> None:
        self._r = r
        self._table_z_m = table_z_m
        lines = [resample(fragment.points, STEP_RADII * r) for fragment in fragments]
        fragment_of_point = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
        points = np.vstack(lines)
        along = [arc_length(line) for line in lines]
        self.is_string = _tube_shares(points, fragment_of_point, surface, r) >= MIN_TUBE_SHARE
        # Only the points of visible strings are kept.
        is_string = self.is_string[fragment_of_point]
        self._points = points[is_string]
        self._fragment = fragment_of_point[is_string]
        tangents = [unit_vectors(np.gradient(line[:, :2], axis=0)) for line in lines]
        self._tangents = np.vstack(tangents)[is_string]
        self._to_start = np.concatenate(along)[is_string]
        self._to_end = np.concatenate([s[-1] - s for s in along])[is_string]
        self._tree = KDTree(self._points[:, :2]) if len(self._points) else None

    def strands_over(self, points: Points, ends: Indices, end_fragment: Indices) -> Indices:
        """Return how many other strands curves between ends pass under, from one side of their line to the other side.

        Args:
            points: (M, N, 3) points of the curves, metres, base frame.
            ends: (M, K) indices of the ends that each curve continues. The ends 2 k and 2 k + 1 belong to one fragment.
            end_fragment: (E,) fragment of each end.

        Returns:
            Number (M,) of strands over each curve.
        """
        count, n = points.shape[:2]
        if self._tree is None or count == 0:
            return np.zeros(count, dtype=np.int64)
        flat = points.reshape(-1, 3)
        # Point `row` of the curves lies under point `over` of the strands.
        row, over = pairs_between(KDTree(flat[:, :2]), self._tree, OVER_RADII * self._r)
        height = self._points[over, 2]
        lower_end = points[:, [0, -1], 2].min(axis=1)
        is_above_table = height - self._table_z_m > MIN_OVER_RADII * self._r
        is_above_curve = height > lower_end[row // n] - MAX_DROP_RADII * self._r
        is_over = is_above_table & is_above_curve
        row = row[is_over]
        over = over[is_over]
        is_other = ~self._is_own(over, ends[row // n], end_fragment)
        row = row[is_other]
        over = over[is_other]
        return self._count_crossed(flat[row], over, row // n, count)

    def _is_own(self, over: Indices, ends: Indices, end_fragment: Indices) -> NDArray[np.bool_]:
        """Return which points `over` (P,) of the strands are near one of the ends (P, K) that their curves continue."""
        is_own = np.zeros(len(over), dtype=np.bool_)
        for end in ends.T:
            is_start = end % 2 == 0
            distance = np.where(is_start, self._to_start[over], self._to_end[over])
            is_own |= (self._fragment[over] == end_fragment[end]) & (distance < OWN_RADII * self._r)
        return is_own

    def touches(self, points: Points, ends: Indices, end_fragment: Indices) -> NDArray[np.bool_]:
        """Return which curves (M,) between ends touch another strand than the two that they continue.

        The arguments are those of `strands_over`.
        """
        touching = np.zeros(len(points), dtype=np.bool_)
        if self._tree is None or len(points) == 0:
            return touching
        n = points.shape[1]
        row, near = pairs_between(KDTree(points.reshape(-1, 3)), KDTree(self._points), TOUCHING_RADII * self._r)
        curve = row // n
        is_other = (self._fragment[near][:, None] != end_fragment[ends[curve]]).all(axis=1)
        touching[curve[is_other]] = True
        return touching

    def length_along(self, points: Points, ends: Indices, end_fragment: Indices) -> NDArray[np.float64]:
        """Return the length (M,) over which curves between ends run along another strand than those that they join.

        The arguments are those of `strands_over`.
        """
        if self._tree is None or len(points) == 0:
            return np.zeros(len(points))
        n = points.shape[1]
        xy = points[:, :, :2]
        flat = xy.reshape(-1, 2)
        tangent = unit_vectors(np.gradient(xy, axis=1)).reshape(-1, 2)
        row, near = pairs_between(KDTree(flat), self._tree, OVER_RADII * self._r)
        is_other = (self._fragment[near][:, None] != end_fragment[ends[row // n]]).all(axis=1)
        is_along = np.abs((tangent[row] * self._tangents[near]).sum(axis=1)) > MIN_ALONG_COSINE
        along = np.zeros(len(flat), dtype=np.bool_)
        along[row[is_other & is_along]] = True
        length = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
        return along.reshape(-1, n).mean(axis=1) * length

    def _count_crossed(self, points: Points, over: Indices, curve: Indices, count: int) -> Indices:
        """Return the number (M,) of strands of which each curve has points on both sides.

        `points` (K, 3) lie on the curves `curve` (K,), and under the points `over` (K,) of strands.
        """
        offset = points[:, :2] - self._points[over, :2]
        tangent = self._tangents[over]
        along = np.abs((offset * tangent).sum(axis=1))
        is_beside = along < STEP_RADII * self._r
        side = planar_cross(tangent, offset)[is_beside]
        # The key is a pair of a curve and a fragment.
        n_fragments = int(self._fragment.max(initial=0)) + 1
        key = curve[is_beside] * n_fragments + self._fragment[over[is_beside]]
        pair, index = np.unique(key, return_inverse=True)
        farthest_left = np.full(len(pair), -np.inf)
        farthest_right = np.full(len(pair), np.inf)
        np.maximum.at(farthest_left, index, side)
        np.minimum.at(farthest_right, index, side)
        is_crossed = (farthest_left > 0) & (farthest_right < 0)
        return np.bincount(pair[is_crossed] // n_fragments, minlength=count)

    def height_over(self, xy: Points) -> NDArray[np.float64]:
        """Return the height (M,) of the highest line within `OVER_RADII` of points (M, 2), above the table, metres."""
        height = np.full(len(xy), -np.inf)
        if self._tree is not None and len(xy):
            for k, near in enumerate(self._tree.query_ball_point(xy, OVER_RADII * self._r)):
                height[k] = self._points[near, 2].max(initial=-np.inf) - self._table_z_m
        return height


def _tube_shares(points: Points, fragment: Indices, surface: Points, r: float) -> NDArray[np.float64]:
    """Return the share of the surface beside each fragment that lies on its tube, from the `points` of its line."""
    distance, nearest = KDTree(points).query(surface, distance_upper_bound=BESIDE_RADII * r)
    is_beside = np.isfinite(distance)
    owner = fragment[np.asarray(nearest)[is_beside]]
    count = int(fragment[-1]) + 1
    is_on = np.abs(np.asarray(distance)[is_beside] - r) < ON_TUBE_RADII * r
    return np.bincount(owner, is_on, count) / np.maximum(np.bincount(owner, minlength=count), 1)
