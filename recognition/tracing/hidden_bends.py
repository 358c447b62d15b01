"""Bends of strings where other strings hide them, or that are too tight for a fragment, as in a tight knot.

A string takes the shape of least bending energy under the constraints of its contacts. In a tight knot, it turns by a
right angle and more under another strand. The extrapolation of its ends says little there, but the curve that must join
two ends of one strand still bends less than a curve that joins ends of two strands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.joining_curves import N_SAMPLES, JoiningCurves, first_crossings, joining_curves
from recognition.geometry.polyline import angles_between, arc_length, fit_end_parabola, unit_vectors
from recognition.tracing.fragments import Fragment
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.visible_strings import VisibleStrings

MAX_LENGTH_RADII = 9.0
"""Maximum length of a joining curve per strand over it, in radii r. One that crosses at 25 degrees hides about 8 r."""
MAX_STRANDS_OVER = 2
"""Maximum number of strands over a joining curve. The bight of a square knot lies under both parts of the other one."""
MAX_BREAK_RADII = 3.0
"""Maximum length of a visible bend in which a fragment breaks, in radii r. Another strand must touch such a bend."""
MAX_TOP_RADII = 0.35
"""Maximum distance of the measured surface from the top of a visible bend, in radii r."""
FULLNESS = (1.0, 0.8, 0.6, 0.45)
"""Lengths of the tangents of the joining curves that are tried, relative to those of an arc."""
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
SEEN_COST_PER_RADIUS = 1.0
"""Cost of a joining curve per radius r of the length that at least `MIN_EXTENT_VIEWS` views look through."""
MIN_EXTENT_VIEWS = 2
"""Minimum number of views that look through a part of a curve where no string is likely."""
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


@dataclass(frozen=True, eq=False)
class _FittedEnds:
    """The two ends of every open fragment, fitted to the longest part that a parabola explains."""

    fragment: Indices
    """(E,) index of the fragment of each end."""
    points: Points
    """(E, 3) positions, metres, base frame."""
    directions: Points
    """(E, 3) unit vectors pointing out of the fragment."""


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """What may hide a curve, and what was measured where it would be."""

    strings: VisibleStrings
    """The fragments that are visible parts of strings."""
    occlusion_map: OcclusionMap
    """Occlusion map of the registered surface."""
    r: float
    """Radius of the string, metres."""


def find_hidden_bends(
    end_fragment: Indices, fragments: Sequence[Fragment], strings: VisibleStrings, occlusion_map: OcclusionMap, r: float
) -> HiddenBends:
    """Find the pairs of ends that a curve under other strands may join, and the cost of its bending energy.

    Args:
        end_fragment: (E,) fragment of each end. The ends 2 k and 2 k + 1 are the first and the last point of one.
        fragments: Fragments of the scene.
        strings: The fragments that are visible parts of strings.
        occlusion_map: Occlusion map of the registered surface.
        r: Radius of the string, metres.

    Returns:
        The pairs, each with the curve of least cost. Only fragments that are visible parts of strings, not edges of
        objects, are joined or hide a curve.
    """
    ends = _fit_ends(end_fragment, fragments, r)
    surroundings = _Surroundings(strings, occlusion_map, r)
    pairs = _near_pairs(ends, fragments, strings, r)
    a, b = pairs.T
    cost = np.full(len(pairs), np.inf)
    curves = np.empty((len(pairs), N_SAMPLES, 3))
    for fullness in FULLNESS:
        tried = joining_curves(ends.points[a], ends.directions[a], ends.points[b], -ends.directions[b], fullness)
        is_possible = _is_possible(tried, pairs, end_fragment, surroundings, is_arc=fullness == 1.0)
        cost_of_tried = _cost(tried, is_possible, surroundings)
        is_better = cost_of_tried < cost
        cost[is_better] = cost_of_tried[is_better]
        curves[is_better] = tried.points[is_better]
    is_joined = np.isfinite(cost)
    pairs = pairs[is_joined]
    curves = curves[is_joined]
    a, b = pairs.T
    is_hidden_ahead = np.zeros(len(end_fragment), dtype=np.bool_)
    is_hidden_ahead[pairs] = True
    return HiddenBends(a, b, cost[is_joined], curves, _conflicts(a, b, curves, strings, r), is_hidden_ahead)


def _near_pairs(ends: _FittedEnds, fragments: Sequence[Fragment], strings: VisibleStrings, r: float) -> Indices:
    """Return the pairs (M, 2) of ends of visible strings that are near and roughly face each other."""
    ends_of_strings = np.flatnonzero(strings.is_string[ends.fragment])
    first, second = np.triu_indices(len(ends_of_strings), 1)
    a = ends_of_strings[first]
    b = ends_of_strings[second]
    chord = ends.points[b] - ends.points[a]
    lengths = np.array([arc_length(fragment.points)[-1] for fragment in fragments])
    is_chosen = (ends.fragment[a] != ends.fragment[b]) | (lengths[ends.fragment[a]] > MIN_RING_RADII * r)
    is_chosen &= np.linalg.norm(chord, axis=1) < MAX_STRANDS_OVER * MAX_LENGTH_RADII * r
    is_chosen &= angles_between(ends.directions[a], chord) < MAX_TURN_RAD
    is_chosen &= angles_between(ends.directions[b], -chord) < MAX_TURN_RAD
    return np.column_stack([a, b])[is_chosen]


def _is_possible(
    curves: JoiningCurves, pairs: Indices, end_fragment: Indices, surroundings: _Surroundings, is_arc: bool
) -> NDArray[np.bool_]:
    """Return which curves (M,) that join the `pairs` (M, 2) of ends are hidden, or are visible bends.

    Only between two strands, views can see that a curve is narrower than an arc. `is_arc` says that it is none of them.
    """
    strings = surroundings.strings
    r = surroundings.r
    strands_over = strings.strands_over(curves.points, pairs, end_fragment)
    is_possible = curves.length < MAX_LENGTH_RADII * r * np.minimum(strands_over, MAX_STRANDS_OVER)
    is_possible &= (strands_over > 1) | is_arc
    short = np.flatnonzero(curves.length < MAX_BREAK_RADII * r)
    breaks = short[strings.touches(curves.points[short], pairs[short], end_fragment)]
    if len(breaks):
        is_possible[breaks] |= _is_measured(curves.points[breaks], surroundings.occlusion_map.surface, r)
    return is_possible


def _cost(curves: JoiningCurves, is_possible: NDArray[np.bool_], surroundings: _Surroundings) -> NDArray[np.float64]:
    """Return the cost (M,) of curves, infinite for those that are impossible or over bare table."""
    r = surroundings.r
    samples = curves.points[is_possible].reshape(-1, 3)
    length = curves.length[is_possible] / r
    seen = surroundings.occlusion_map.views_through(samples, r)
    is_bare = surroundings.occlusion_map.occlusion(samples, r).is_uncovered | seen.is_free
    is_seen_through = seen.through >= MIN_EXTENT_VIEWS
    bare = is_bare.reshape(-1, N_SAMPLES).mean(axis=1) * length
    seen_through = is_seen_through.reshape(-1, N_SAMPLES).mean(axis=1) * length
    energy = r * curves.energy[is_possible] * np.minimum(length / MIN_BENDING_LENGTH_RADII, 1.0)
    cost_of_possible = BEND_COST + ENERGY_COST_RADII * energy
    cost_of_possible += LENGTH_COST_PER_RADIUS * length + SEEN_COST_PER_RADIUS * seen_through
    cost = np.full(len(is_possible), np.inf)
    cost[is_possible] = np.where(bare <= MAX_BARE_RADII, cost_of_possible, np.inf)
    return cost


def _is_measured(curves: Points, surface: Points, r: float) -> NDArray[np.bool_]:
    """Return of which curves (M, N, 3) the top of the tube is measured over the whole length, as a mask (M,)."""
    distance, _ = KDTree(surface).query(curves + (0.0, 0.0, r), distance_upper_bound=MAX_TOP_RADII * r)
    return np.isfinite(distance).all(axis=1)


def _fit_ends(end_fragment: Indices, fragments: Sequence[Fragment], r: float) -> _FittedEnds:
    """Fit the position and the outward direction of each end."""
    points = []
    directions = []
    for k, fragment in enumerate(end_fragment):
        # The first point of a fragment comes before its last point.
        is_start = k % 2 == 0
        line = fragments[fragment].points
        from_end = line if is_start else line[::-1]
        point, direction = _fit_end(from_end, r)
        points.append(point)
        directions.append(direction)
    return _FittedEnds(end_fragment, np.array(points), np.array(directions))


def _fit_end(points: Points, r: float) -> tuple[Points, Points]:
    """Return the position (3,) and the outward direction (3,) of the first point of a line.

    The longest part that a parabola explains is fitted. In tight knots, longer parts average over more than one bend.
    """
    s = arc_length(points)
    terms = np.zeros((3, 3))
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
    low = curves[:, :, :2].min(axis=1)
    high = curves[:, :, :2].max(axis=1)
    is_near = ((low[i] < high[j]) & (low[j] < high[i])).all(axis=1)
    is_near &= (a[i] != a[j]) & (a[i] != b[j]) & (b[i] != a[j]) & (b[i] != b[j])
    near = np.column_stack([i, j])[is_near]
    crosses, on_i, on_j = first_crossings(curves[near[:, 0]], curves[near[:, 1]])
    on_i = on_i[crosses]
    on_j = on_j[crosses]
    has_room = strings.height_over(on_i[:, :2]) >= MIN_STACK_RADII * r
    is_apart = np.abs(on_i[:, 2] - on_j[:, 2]) >= MIN_SEPARATION_RADII * r
    return near[crosses][~(has_room | is_apart)]
