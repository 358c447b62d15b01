"""Bends of strings where another string hides them, as in a tight knot.

A string takes the shape of least bending energy under the constraints of its contacts. In a tight knot, it turns by a
right angle and more under another strand. The extrapolation of its ends says little there, but the curve that must join
two ends of one strand still bends less than a curve that joins ends of two strands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.joining_curves import N_SAMPLES, first_crossings, joining_curves
from recognition.geometry.polyline import angles_between, arc_length, fit_end_parabola, resample, unit_vectors
from recognition.tracing.fragments import Fragment
from recognition.tracing.occlusion_map import OcclusionMap

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
MAX_LENGTH_RADII = 9.0
"""Maximum length of a joining curve, in radii r. An over strand that crosses at 25 degrees hides about 8 r."""
MAX_TURN_RAD = 2.2
"""Maximum angle between the direction of an end and the straight line to its partner, radians."""
END_FIT_RADII = np.arange(8.0, 3.4, -0.5)
"""Lengths of the part of a fragment that is fitted to get the direction of its end, in radii r, longest first."""
MAX_END_RESIDUAL_RADII = 0.06
"""Maximum root mean square residual of this fit, in radii r. Nodes scatter by about half of it."""
MIN_RING_RADII = 12.0
"""Minimum length of a fragment whose two ends may be paired with each other, in radii r."""
MAX_BARE_RADII = 1.0
"""Maximum length of bare table under a joining curve, in radii r. Bare table cannot hide a string."""
MIN_STACK_RADII = 4.0
"""Minimum height of a strand over two strands that cross under it at any heights, in radii r.

The line of a strand over one strand is at 3 r, over two strands at 5 r.
"""
MIN_SEPARATION_RADII = 1.0
"""Minimum difference in height of two strands that cross under a lower strand, in radii r. Soft strands have 1.2."""
BEND_COST = 1.0
"""Cost of a bend that the extrapolation of the ends does not explain, in squared sigmas."""
ENERGY_COST_RADII = 1.0
"""Cost of the bending energy of a joining curve, in squared sigmas per energy of 1 / r."""
LENGTH_COST_PER_RADIUS = 0.25
"""Cost of a joining curve per radius r of its length."""
MIN_BENDING_LENGTH_RADII = 3.0
"""Minimum length over which the directions of the ends change, in radii r.

They are fitted to parts of about this length, so that bends over shorter lengths are within their errors.
"""

Points = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class HiddenBends:
    """Pairs of ends that a curve under other strands may join."""

    a: Indices
    """(M,) index of the first end of each pair."""
    b: Indices
    """(M,) index of the second end of each pair, above that of the first."""
    cost: NDArray[np.float64]
    """(M,) cost of each pair, in squared sigmas."""
    curves: Points
    """(M, N, 3) points of the curve that joins each pair, from end to end, metres, base frame."""
    conflicts: Indices
    """(L, 2) indices of pairs of which only one is possible: there is no room for both curves under the strand."""
    is_hidden_ahead: NDArray[np.bool_]
    """(E,) mask of all ends, True where a strand may hide the continuation of the end."""


def find_hidden_bends(
    end_fragment: Indices, fragments: Sequence[Fragment], occlusion_map: OcclusionMap, r: float, table_z_m: float
) -> HiddenBends:
    """Find the pairs of ends that a curve under other strands may join, and the cost of its bending energy.

    Args:
        end_fragment: (E,) fragment of each end. The ends 2 k and 2 k + 1 are the first and the last point of one.
        fragments: Fragments of the scene.
        occlusion_map: Occlusion map of the registered surface.
        r: Radius of the string, metres.
        table_z_m: Height of the table, metres, base frame.

    Returns:
        The pairs. Only fragments that are visible parts of strings, not edges of objects, are joined or hide a curve.
    """
    nothing = np.empty(0, dtype=np.int64)
    is_hidden_ahead = np.zeros(len(end_fragment), dtype=np.bool_)
    none = HiddenBends(
        nothing, nothing, np.empty(0), np.empty((0, N_SAMPLES, 3)), np.empty((0, 2), dtype=np.int64), is_hidden_ahead
    )
    strings = VisibleStrings(fragments, occlusion_map.surface, r, table_z_m)
    fitted = [_fit_end(fragments[f].points[:: 1 - 2 * (k % 2)], r) for k, f in enumerate(end_fragment)]
    points, directions = (np.array(values) for values in zip(*fitted, strict=True))
    ends = np.flatnonzero(strings.is_string[end_fragment])
    first, second = np.triu_indices(len(ends), 1)
    a, b = ends[first], ends[second]
    chord = points[b] - points[a]
    gap = np.linalg.norm(chord, axis=1)
    lengths = np.array([arc_length(fragment.points)[-1] for fragment in fragments])
    may_close = (end_fragment[a] != end_fragment[b]) | (lengths[end_fragment[a]] > MIN_RING_RADII * r)
    turn = np.maximum(angles_between(directions[a], chord), angles_between(directions[b], -chord))
    near = np.flatnonzero((gap < MAX_LENGTH_RADII * r) & (turn < MAX_TURN_RAD) & may_close)
    if len(near) == 0:
        return none
    a, b = a[near], b[near]
    curves = joining_curves(points[a], directions[a], points[b], -directions[b])
    crosses = strings.crosses(curves.points, np.column_stack([a, b]), end_fragment)
    occlusion = occlusion_map.occlusion(curves.points.reshape(-1, 3), r)
    bare_length = occlusion.is_uncovered.reshape(len(a), -1).mean(axis=1) * curves.length
    is_possible = crosses & (curves.length < MAX_LENGTH_RADII * r)
    chosen = np.flatnonzero(is_possible & (bare_length <= MAX_BARE_RADII * r))
    short = np.minimum(curves.length / (MIN_BENDING_LENGTH_RADII * r), 1.0)
    cost = BEND_COST + ENERGY_COST_RADII * r * curves.energy * short + LENGTH_COST_PER_RADIUS * curves.length / r
    a, b, cost = a[chosen], b[chosen], cost[chosen]
    is_hidden_ahead[[*a, *b]] = True
    points = curves.points[chosen]
    return HiddenBends(a, b, cost, points, _conflicts(a, b, points, strings, r), is_hidden_ahead)


class VisibleStrings:
    """The fragments that are visible parts of strings, and what they hide.

    Args:
        fragments: Fragments of the scene.
        surface: (M, 3) registered surface points, metres, base frame.
        r: Radius of the string, metres.
        table_z_m: Height of the table, metres, base frame.
    """

    def __init__(self, fragments: Sequence[Fragment], surface: Points, r: float, table_z_m: float = 0.0) -> None:
        self._r, self._table_z_m = r, table_z_m
        lines = [resample(fragment.points, STEP_RADII * r) for fragment in fragments]
        fragment_of_point = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
        points, along = np.vstack(lines), [arc_length(line) for line in lines]
        self.is_string = _tube_shares(points, fragment_of_point, surface, r) >= MIN_TUBE_SHARE
        is_string = self.is_string[fragment_of_point]
        self._points, self._fragment = points[is_string], fragment_of_point[is_string]
        tangents = [unit_vectors(np.gradient(line[:, :2], axis=0)) for line in lines]
        self._tangents = np.vstack(tangents)[is_string]
        self._to_start = np.concatenate(along)[is_string]
        self._to_end = np.concatenate([s[-1] - s for s in along])[is_string]
        self._tree = KDTree(self._points[:, :2]) if len(self._points) else None

    def crosses(self, points: Points, ends: Indices, end_fragment: Indices) -> NDArray[np.bool_]:
        """Return which curves between ends pass under another strand, from one side of its line to the other side.

        Args:
            points: (M, N, 3) points of the curves, metres, base frame.
            ends: (M, K) indices of the ends that each curve continues. The ends 2 k and 2 k + 1 belong to one fragment.
            end_fragment: (E,) fragment of each end.

        Returns:
            Mask (M,) of the curves.
        """
        count, n = points.shape[:2]
        if self._tree is None or count == 0:
            return np.zeros(count, dtype=np.bool_)
        flat = points.reshape(-1, 3)
        pairs = KDTree(flat[:, :2]).sparse_distance_matrix(self._tree, OVER_RADII * self._r, output_type="ndarray")
        row, over = pairs["i"], pairs["j"]
        lower_end = points[:, [0, -1], 2].min(axis=1)
        height = self._points[over, 2]
        is_over = (height - self._table_z_m > MIN_OVER_RADII * self._r) & (
            height > lower_end[row // n] - MAX_DROP_RADII * self._r
        )
        row, over = row[is_over], over[is_over]
        is_own = np.zeros(len(row), dtype=np.bool_)
        for end in ends[row // n].T:
            distance = np.where(end % 2 == 0, self._to_start[over], self._to_end[over])
            is_own |= (self._fragment[over] == end_fragment[end]) & (distance < OWN_RADII * self._r)
        row, over = row[~is_own], over[~is_own]
        return self._has_both_sides(flat[row], over, row // n, count)

    def _has_both_sides(self, points: Points, over: Indices, curve: Indices, count: int) -> NDArray[np.bool_]:
        """Return which curves (M,) have points on both sides of a strand.

        `points` (K, 3) lie on the curves `curve` (K,), and under the points `over` (K,) of strands.
        """
        offset, tangent = points[:, :2] - self._points[over, :2], self._tangents[over]
        along = np.abs((offset * tangent).sum(axis=1))
        is_beside = along < STEP_RADII * self._r
        side = (tangent[:, 0] * offset[:, 1] - tangent[:, 1] * offset[:, 0])[is_beside]
        key = curve[is_beside] * (int(self._fragment.max(initial=0)) + 1) + self._fragment[over[is_beside]]
        pair, index = np.unique(key, return_inverse=True)
        left, right = np.full(len(pair), -np.inf), np.full(len(pair), np.inf)
        np.maximum.at(left, index, side)
        np.minimum.at(right, index, side)
        crosses = np.zeros(count, dtype=np.bool_)
        crosses[pair[(left > 0) & (right < 0)] // (int(self._fragment.max(initial=0)) + 1)] = True
        return crosses

    def height_over(self, xy: Points) -> NDArray[np.float64]:
        """Return the height (M,) of the highest line within `OVER_RADII` of points (M, 2), above the table, metres."""
        height = np.full(len(xy), -np.inf)
        if self._tree is not None and len(xy):
            for k, near in enumerate(self._tree.query_ball_point(xy, OVER_RADII * self._r)):
                height[k] = self._points[near, 2].max(initial=-np.inf) - self._table_z_m
        return height


def _fit_end(points: Points, r: float) -> tuple[Points, Points]:
    """Return the position (3,) and the outward direction (3,) of the first point of a line.

    The longest part that a parabola explains is fitted. In tight knots, longer parts average over more than one bend.
    """
    s, terms = arc_length(points), np.zeros((3, 3))
    for length in END_FIT_RADII:
        terms = fit_end_parabola(points, length * r, r)
        count = max(int(np.searchsorted(s, length * r)) + 1, 2)
        residuals = np.vander(s[:count], 3, increasing=True) @ terms - points[:count]
        if np.sqrt((residuals**2).sum(axis=1).mean()) < MAX_END_RESIDUAL_RADII * r:
            break
    return terms[0], -unit_vectors(terms[1])


def _conflicts(a: Indices, b: Indices, curves: Points, strings: VisibleStrings, r: float) -> Indices:
    """Return the pairs (L, 2) of joining curves that would cross at the same height under a strand.

    If the strand is high enough for both curves, one of them may pass above or below the other one.
    """
    i, j = np.triu_indices(len(a), 1)
    low, high = curves[:, :, :2].min(axis=1), curves[:, :, :2].max(axis=1)
    is_near = ((low[i] < high[j]) & (low[j] < high[i])).all(axis=1)
    is_near &= (a[i] != a[j]) & (a[i] != b[j]) & (b[i] != a[j]) & (b[i] != b[j])
    i, j = i[is_near], j[is_near]
    crosses, on_i, on_j = first_crossings(curves[i], curves[j])
    i, j, on_i, on_j = i[crosses], j[crosses], on_i[crosses], on_j[crosses]
    has_room = strings.height_over(on_i[:, :2]) >= MIN_STACK_RADII * r
    is_apart = np.abs(on_i[:, 2] - on_j[:, 2]) >= MIN_SEPARATION_RADII * r
    return np.column_stack([i, j])[~(has_room | is_apart)]


def _tube_shares(points: Points, fragment: Indices, surface: Points, r: float) -> NDArray[np.float64]:
    """Return the share of the surface beside each fragment that lies on its tube, from the `points` of its line."""
    distance, nearest = KDTree(points).query(surface, distance_upper_bound=BESIDE_RADII * r)
    is_beside = np.isfinite(distance)
    owner, count = fragment[np.asarray(nearest)[is_beside]], int(fragment[-1]) + 1
    is_on = np.abs(np.asarray(distance)[is_beside] - r) < ON_TUBE_RADII * r
    return np.bincount(owner, is_on, count) / np.maximum(np.bincount(owner, minlength=count), 1)
