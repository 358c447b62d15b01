"""Pairing of fragment ends: one optimisation decides for the whole scene which ends continue each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.graph_matching import matching_margins, maximum_weight_matching
from recognition.geometry.polyline import arc_length, fit_end_parabola
from recognition.parameters import ChainParameters
from recognition.tracing.fragments import Fragment
from recognition.tracing.height_map import HeightMap

END_FIT_RADII = 5.0
"""Length of string, in radii, from which the direction and the curvature of an end are taken."""
MAX_GAP_RADII = 14.0
"""Maximum gap that is bridged, in radii. A strand that passes over at 25 degrees hides about 8."""
MIN_BEND_RADII = 2.5
"""Minimum bend radius of a string, in radii of the string."""
MIN_RING_RADII = 12.0
"""Minimum length of a fragment that may close on itself, in radii."""
MAX_TURN_RAD = 1.4
"""Maximum angle between the direction of an end and the line to its partner, radians."""
HEIGHT_WEIGHT = 0.5
"""Weight of height differences, compared with horizontal ones. Next to a strand on top, heights are measured worst."""
SINGLE_END_COST = 1.5
"""Cost of a visible end that stays single, in the unit of the misfit (squared sigmas)."""
OCCLUDED_END_COST = 4.0
"""Additional cost if another strand lies over the continuation of the end."""
GAP_COST_PER_RADIUS = 0.25
"""Cost of a gap for each radius of its length."""
VISIBLE_GAP_COST_PER_RADIUS = 1.0
"""Additional cost for each radius of a gap that no strand occludes, beyond `FREE_VISIBLE_GAP_RADII`.

A string in such a gap would have been measured.
"""
FREE_VISIBLE_GAP_RADII = 3.0
"""Length of a gap, in radii, that may be visible at no additional cost."""
MAX_BARE_GAP_RADII = 1.0
"""Maximum length of a gap over bare table, in radii. Noise leaves such holes, and no string is hidden there."""
MIN_CERTAIN_MARGIN = 2.0
"""A pair is ambiguous if excluding it raises the minimum cost by less than this."""


@dataclass(frozen=True, eq=False)
class FragmentEnds:
    """Both ends of every open fragment, the start before the end."""

    fragment: NDArray[np.int64]
    """(N,) index of the fragment."""
    points: NDArray[np.float64]
    """(N, 3) smoothed positions, metres, base frame."""
    directions: NDArray[np.float64]
    """(N, 3) unit vectors pointing out of the fragment."""
    curvatures: NDArray[np.float64]
    """(N, 3) curvature vectors across the direction, 1/m."""

    def extrapolate(
        self, indices: NDArray[np.int64], distance: NDArray[np.float64], curvature_share: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the continuation of ends beyond the fragments.

        Args:
            indices: (M,) ends to continue.
            distance: (M,) distance ahead of each end, metres.
            curvature_share: Share of the curvature that is used, 0 to 1.

        Returns:
            (M, 3) points, metres, base frame, and (M, 3) unit directions there.
        """
        curve = curvature_share * self.curvatures[indices] * distance[:, None]
        points = self.points[indices] + distance[:, None] * (self.directions[indices] + curve / 2)
        directions = self.directions[indices] + curve
        return points, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Pairing:
    """Pairs of ends that continue each other."""

    ends: FragmentEnds
    """Ends of all open fragments."""
    pairs: list[tuple[int, int]]
    """Two indices into `ends` for each pair."""
    ambiguous_points: list[NDArray[np.float64]]
    """(3,) middle of each pair that has nearly as good alternatives, metres, base frame."""


def pair_ends(fragments: Sequence[Fragment], height_map: HeightMap, parameters: ChainParameters) -> Pairing:
    """Return the pairs of ends that bend least, over all intersections of the scene at once.

    The cost of a pair is its misfit plus the cost of its gap. For the misfit, both ends are extrapolated to the middle
    of the gap; their difference in position and direction there counts in squared sigmas. An end may stay single, at a
    cost that is higher if another strand lies over its continuation. The pairs are a maximum weight matching.

    Args:
        fragments: Fragments of the scene.
        height_map: Height map of the registered surface.
        parameters: Radius r.

    Returns:
        The ends, the pairs, and the positions of ambiguous pairs.

    Source:
        Ours, a generalisation of eq. (8) (section III.E.2). Eq. (8) adds v_j . v_k over the two pairs of the four ends
        at one intersection. This sum runs over all pairs of the scene.
    """
    ends = _collect_ends(fragments, parameters.r)
    if len(ends.points) < 2:
        return Pairing(ends, [], [])
    single_cost = SINGLE_END_COST + OCCLUDED_END_COST * _occluded_share_ahead(ends, height_map, parameters.r)
    a, b = _candidate_pairs(ends, fragments, parameters.r)
    cost = _misfit(ends, a, b, parameters.r) + _gap_cost(ends, a, b, height_map, parameters.r)
    gain = single_cost[a] + single_cost[b] - cost
    has_gain = gain > 0
    a, b, gain = a[has_gain], b[has_gain], gain[has_gain]
    matched = maximum_weight_matching(a, b, gain)
    ambiguous = matched[matching_margins(matched, a, b, gain) < MIN_CERTAIN_MARGIN]
    ambiguous_points = list((ends.points[a[ambiguous]] + ends.points[b[ambiguous]]) / 2)
    return Pairing(ends, list(zip(a[matched].tolist(), b[matched].tolist(), strict=True)), ambiguous_points)


def _collect_ends(fragments: Sequence[Fragment], r: float) -> FragmentEnds:
    indices, points, directions, curvatures = [], [], [], []
    for index, fragment in enumerate(fragments):
        if fragment.closed:
            continue
        for order in (1, -1):
            point, direction, curvature = _fit_end(fragment.points[::order], r)
            indices.append(index)
            points.append(point)
            directions.append(direction)
            curvatures.append(curvature)
    return FragmentEnds(
        fragment=np.array(indices, dtype=np.int64),
        points=np.array(points).reshape(-1, 3),
        directions=np.array(directions).reshape(-1, 3),
        curvatures=np.array(curvatures).reshape(-1, 3),
    )


def _fit_end(
    points: NDArray[np.float64], r: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return position, outward direction and curvature of a line (N, 3) at its first point, from a parabola."""
    terms = fit_end_parabola(points, END_FIT_RADII * r, r)
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    curvature = 2 * terms[2] - 2 * (terms[2] @ direction) * direction
    return terms[0], direction, curvature / max(1.0, float(np.linalg.norm(curvature)) * MIN_BEND_RADII * r)


def _candidate_pairs(
    ends: FragmentEnds, fragments: Sequence[Fragment], r: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (M,) and (M,) the ends of the pairs that are near and roughly face each other."""
    a, b = np.triu_indices(len(ends.points), 1)
    may_close = np.array([arc_length(f.points)[-1] > MIN_RING_RADII * r for f in fragments], dtype=bool)
    offset = ends.points[b] - ends.points[a]
    gap = np.linalg.norm(offset, axis=1)
    is_near = (gap <= MAX_GAP_RADII * r) & ((ends.fragment[a] != ends.fragment[b]) | may_close[ends.fragment[a]])
    turn = np.maximum(_angle(offset, ends.directions[a]), _angle(-offset, ends.directions[b]))
    is_candidate = is_near & ((turn < MAX_TURN_RAD) | (gap < 1e-9))
    return a[is_candidate], b[is_candidate]


def _misfit(ends: FragmentEnds, a: NDArray[np.int64], b: NDArray[np.int64], r: float) -> NDArray[np.float64]:
    """Return (M,) the difference of the two ends of each pair in the middle of the gap, in squared sigmas.

    Curvatures are known only roughly. The smallest misfit with none, half and all of the curvature counts.
    """
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    misfits = []
    for share in (0.0, 0.5, 1.0):
        (p, u), (q, v) = (ends.extrapolate(k, gap / 2, share) for k in (a, b))
        tangent = u - v
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
        offset = p - q
        offset = offset - (offset * tangent).sum(axis=1, keepdims=True) * tangent
        offset[:, 2] *= HEIGHT_WEIGHT
        position_sigmas = np.linalg.norm(offset, axis=1) / (0.4 * r + 0.06 * gap)
        direction_sigmas = _angle(u, -v) / (0.2 + 0.06 * gap / r)
        misfits.append(position_sigmas**2 + direction_sigmas**2 + 0.3 * share)
    return np.min(misfits, axis=0)


def _gap_cost(
    ends: FragmentEnds, a: NDArray[np.int64], b: NDArray[np.int64], height_map: HeightMap, r: float
) -> NDArray[np.float64]:
    """Return (M,) the cost of each pair's gap. It is infinite over bare table, where nothing can be hidden."""
    if len(a) == 0:
        return np.empty(0)
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    t = np.linspace(0, 1, 14)[1:-1]
    h = [2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, t**3 - t**2]
    hermite = [value[None, :, None] for value in h]
    length = gap[:, None, None]
    start, end = ends.points[a, None], ends.points[b, None]
    leaving, arriving = ends.directions[a, None] * length, -ends.directions[b, None] * length
    curve = hermite[0] * start + hermite[1] * leaving + (1 - hermite[0]) * end + hermite[2] * arriving
    occlusion = height_map.occlusion(curve.reshape(-1, 3), r)
    occluded_share = occlusion.is_occluded.reshape(len(a), -1).mean(axis=1)
    bare_share = occlusion.is_bare.reshape(len(a), -1).mean(axis=1)
    visible_radii = np.maximum((1 - occluded_share) * gap / r - FREE_VISIBLE_GAP_RADII, 0.0)
    cost = GAP_COST_PER_RADIUS * gap / r + VISIBLE_GAP_COST_PER_RADIUS * visible_radii
    return np.where(bare_share * gap > MAX_BARE_GAP_RADII * r, np.inf, cost)


def _occluded_share_ahead(ends: FragmentEnds, height_map: HeightMap, r: float) -> NDArray[np.float64]:
    """Return (N,) the share of the line ahead of each end, up to 2.5 r, that another strand occludes."""
    distance = np.linspace(0.5, 2.5, 5)[None, :, None] * r
    horizontal = ends.directions * (1, 1, 0)
    points = ends.points[:, None] + distance * horizontal[:, None]
    is_occluded = height_map.occlusion(points.reshape(-1, 3), r).is_occluded
    return is_occluded.reshape(len(ends.points), -1).mean(axis=1)


def _angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (M,) the angles between vectors (M, 3), radians, with heights weighted by `HEIGHT_WEIGHT`."""
    a, b = a * (1, 1, HEIGHT_WEIGHT), b * (1, 1, HEIGHT_WEIGHT)
    cosine = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-12)
    return np.arccos(np.clip(cosine, -1, 1))
