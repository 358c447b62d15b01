"""Which ends of fragments belong together: all of a scene at once, by least bending (eq. 8 generalised)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.graph_matching import matching_margins, maximum_weight_matching
from recognition.geometry.parabola import fit_end_parabola
from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.tracing.fragments import Fragment
from recognition.tracing.height_map import HeightMap

LOOKED_AT = 5.0
"""Length of string, in radii, from which an end's direction and curvature are taken."""
LONGEST_GAP = 14.0
"""Longest gap bridged, in radii: a strand that passes over at 25 degrees hides about 8."""
TIGHTEST_BEND = 2.5
"""Smallest bend radius of a string, in radii."""
SHORTEST_RING = 12.0
"""A fragment shorter than this, in radii, can't close on itself."""
WIDEST_TURN = 1.4
"""Angle, radians, between an end's direction and the way to its partner beyond which they are not looked at."""
HEIGHT_SHARE = 0.5
"""Heights count less than the way across: next to a strand on top, they are what is measured worst."""
OPEN_END = 1.5
"""What an end in the open costs when it stays alone, in the units of the misfit (squared sigmas)."""
COVERED_END = 4.0
"""What it costs more when another strand lies over the place where it would go on."""
GAP_COST = 0.25
"""Cost of a gap for each radius of its length."""
UNCOVERED_COST = 1.0
"""The same for each radius beyond `UNCOVERED_FREE` over which a bridged gap lies open to view: the string that is
said to be there would have been seen."""
UNCOVERED_FREE = 3.0
BARE = 1.0
"""Length of a gap, in radii, that may lie over bare table: noise leaves such holes, and no string is hidden there."""
SAFE_MARGIN = 2.0
"""A couple without which the rest costs no more than this above the best is a doubt to be told."""


@dataclass(frozen=True, eq=False)
class FragmentEnds:
    """Both ends of every open fragment, start before end."""

    fragment: NDArray[np.int64]
    """(N,) which fragment."""
    points: NDArray[np.float64]
    """(N, 3), smoothed."""
    directions: NDArray[np.float64]
    """(N, 3), unit length, out of the fragment."""
    curvatures: NDArray[np.float64]
    """(N, 3), 1/m, across the direction."""

    def ahead(
        self, chosen: NDArray[np.int64], distance: NDArray[np.float64], share: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points and directions, (M, 3) each, `distance` (M,) ahead, with a share of the ends' curvature."""
        curve = share * self.curvatures[chosen] * distance[:, None]
        points = self.points[chosen] + distance[:, None] * (self.directions[chosen] + curve / 2)
        directions = self.directions[chosen] + curve
        return points, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Pairing:
    """The couples of ends that continue one another."""

    ends: FragmentEnds
    couples: list[tuple[int, int]]
    """Indices of ends."""
    doubts: list[NDArray[np.float64]]
    """(3,) each: places where other couples are nearly as good."""


def pair_ends(fragments: Sequence[Fragment], cover: HeightMap, parameters: ChainParameters) -> Pairing:
    """The couples of ends that bend least, over all intersections at once.

    Eq. (8) sums v_j . v_k over the couples of the four ends at one intersection. Here the sum runs over all couples
    of a scene; a couple's cost is how far the two ends, each continued half way across the gap with its curvature,
    miss one another in place and direction, in squared sigmas, plus a price of the gap. An end may stay alone at
    a price too, which is higher where another strand lies over what comes next.
    """
    ends = _fragment_ends(fragments, parameters.r)
    if len(ends.points) < 2:
        return Pairing(ends, [], [])
    alone = OPEN_END + COVERED_END * _covered_ahead(ends, cover, parameters.r)
    a, b = _candidates(ends, fragments, parameters.r)
    cost = _misfit(ends, a, b, parameters.r) + _gap_cost(ends, a, b, cover, parameters.r)
    gain = alone[a] + alone[b] - cost
    worth = gain > 0
    a, b, gain = a[worth], b[worth], gain[worth]
    taken = maximum_weight_matching(a, b, gain)
    doubtful = taken[matching_margins(taken, a, b, gain) < SAFE_MARGIN]
    doubts = list((ends.points[a[doubtful]] + ends.points[b[doubtful]]) / 2)
    return Pairing(ends, list(zip(a[taken].tolist(), b[taken].tolist(), strict=True)), doubts)


def _fragment_ends(fragments: Sequence[Fragment], r: float) -> FragmentEnds:
    which, points, directions, curvatures = [], [], [], []
    for number, fragment in enumerate(fragments):
        if fragment.closed:
            continue
        for order in (1, -1):
            point, direction, curvature = _end_of(fragment.points[::order], r)
            which.append(number)
            points.append(point)
            directions.append(direction)
            curvatures.append(curvature)
    return FragmentEnds(
        np.array(which, dtype=np.int64),
        *(np.array(values).reshape(-1, 3) for values in (points, directions, curvatures)),
    )


def _end_of(
    points: NDArray[np.float64], r: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Place, outward direction and curvature of a line (N, 3) at its first point, from a parabola through it."""
    terms = fit_end_parabola(points, LOOKED_AT * r, r)
    direction = -terms[1] / max(float(np.linalg.norm(terms[1])), 1e-12)
    curvature = 2 * terms[2] - 2 * (terms[2] @ direction) * direction
    return terms[0], direction, curvature / max(1.0, float(np.linalg.norm(curvature)) * TIGHTEST_BEND * r)


def _candidates(
    ends: FragmentEnds, fragments: Sequence[Fragment], r: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(M,) and (M,) couples of ends that are near and roughly face one another."""
    a, b = np.triu_indices(len(ends.points), 1)
    long_enough = np.array([arc_length(f.points)[-1] > SHORTEST_RING * r for f in fragments], dtype=bool)
    way = ends.points[b] - ends.points[a]
    gap = np.linalg.norm(way, axis=1)
    near = (gap <= LONGEST_GAP * r) & ((ends.fragment[a] != ends.fragment[b]) | long_enough[ends.fragment[a]])
    turn = np.maximum(_angle(way, ends.directions[a]), _angle(-way, ends.directions[b]))
    chosen = near & ((turn < WIDEST_TURN) | (gap < 1e-9))
    return a[chosen], b[chosen]


def _misfit(ends: FragmentEnds, a: NDArray[np.int64], b: NDArray[np.int64], r: float) -> NDArray[np.float64]:
    """(M,) squared sigmas by which the couples' ends, continued half way across the gap, miss one another.

    Curvatures are known roughly only: none, half and all of them are tried, and the best counts.
    """
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    tried = []
    for share in (0.0, 0.5, 1.0):
        (p, u), (q, v) = (ends.ahead(k, gap / 2, share) for k in (a, b))
        middle = u - v
        middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
        apart = p - q
        apart = apart - (apart * middle).sum(axis=1, keepdims=True) * middle
        apart[:, 2] *= HEIGHT_SHARE
        in_place = np.linalg.norm(apart, axis=1) / (0.4 * r + 0.06 * gap)
        in_direction = _angle(u, -v) / (0.2 + 0.06 * gap / r)
        tried.append(in_place**2 + in_direction**2 + 0.3 * share)
    return np.min(tried, axis=0)


def _gap_cost(
    ends: FragmentEnds, a: NDArray[np.int64], b: NDArray[np.int64], cover: HeightMap, r: float
) -> NDArray[np.float64]:
    """(M,) price of the couples' gaps. Infinite where a gap lies over bare table: nothing can be hidden there."""
    if len(a) == 0:
        return np.empty(0)
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    share = np.linspace(0, 1, 14)[1:-1]
    h = [2 * share**3 - 3 * share**2 + 1, share**3 - 2 * share**2 + share, share**3 - share**2]
    hermite = [value[None, :, None] for value in h]
    reach = gap[:, None, None]
    start, end = ends.points[a, None], ends.points[b, None]
    leave, arrive = ends.directions[a, None] * reach, -ends.directions[b, None] * reach
    way = hermite[0] * start + hermite[1] * leave + (1 - hermite[0]) * end + hermite[2] * arrive
    covered, bare = (part.reshape(len(a), -1).mean(axis=1) for part in cover.over(way.reshape(-1, 3), r))
    uncovered = np.maximum((1 - covered) * gap / r - UNCOVERED_FREE, 0.0)
    return np.where(bare * gap > BARE * r, np.inf, GAP_COST * gap / r + UNCOVERED_COST * uncovered)


def _covered_ahead(ends: FragmentEnds, cover: HeightMap, r: float) -> NDArray[np.float64]:
    """(N,) share of the way ahead of each end, as far as 2.5 r, that another strand covers."""
    ahead = np.linspace(0.5, 2.5, 5)[None, :, None] * r
    flat = ends.directions * (1, 1, 0)
    places = ends.points[:, None] + ahead * flat[:, None]
    return cover.over(places.reshape(-1, 3), r)[0].reshape(len(ends.points), -1).mean(axis=1)


def _angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M,) angles between vectors (M, 3), with heights counted less."""
    a, b = a * (1, 1, HEIGHT_SHARE), b * (1, 1, HEIGHT_SHARE)
    cosine = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-12)
    return np.arccos(np.clip(cosine, -1, 1))
