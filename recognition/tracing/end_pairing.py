"""Pairing of fragment ends: one optimisation for the whole scene selects the pairs of ends to join."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.graph_matching import matching_margins, matching_without_conflicts
from recognition.geometry.polyline import arc_length, fit_end_parabola
from recognition.parameters import ChainParameters
from recognition.tracing.fragments import Fragment
from recognition.tracing.hidden_bends import HiddenBends, find_hidden_bends
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.visible_strings import VisibleStrings

END_FIT_RADII = 5.0
"""Length of the part of a fragment that is fitted to get the direction and curvature of its end, in radii r."""
MAX_GAP_RADII = 14.0
"""Maximum gap between paired ends, in radii r. An over strand that crosses at 25 degrees hides about 8 r."""
MIN_BEND_RADII = 2.5
"""Minimum bend radius of a string, in radii r."""
MIN_RING_RADII = 12.0
"""Minimum length of a fragment whose two ends may be paired with each other, in radii r."""
MAX_TURN_RAD = 1.4
"""Maximum angle between the direction of an end and the straight line to its partner, radians."""
HEIGHT_WEIGHT = 0.5
"""Weight of height differences relative to horizontal differences. Heights are least accurate near an over strand."""
UNPAIRED_END_COST = 1.5
"""Cost of a visible end without a partner, in squared sigmas like the misfit of a pair."""
OCCLUDED_END_COST = 4.0
"""Additional cost of an occluded end without a partner. It is multiplied by the occluded share ahead of the end."""
GAP_COST_PER_RADIUS = 0.25
"""Cost of a gap per radius r of its length."""
VISIBLE_GAP_COST_PER_RADIUS = 1.0
"""Additional cost per radius r of visible gap, beyond `FREE_VISIBLE_GAP_RADII`.

A gap is visible where no strand occludes it. A string in a visible gap would have been measured.
"""
FREE_VISIBLE_GAP_RADII = 3.0
"""Visible length of a gap without additional cost, in radii r."""
ALONG_COST_PER_RADIUS = 1.0
"""Additional cost per radius r of a gap that runs along a visible string, beyond `FREE_ALONG_RADII`.

A strand that crosses another one is hidden. A strand along another one lies beside it and is visible.
"""
FREE_ALONG_RADII = 3.0
"""Length of a gap along a visible string without additional cost, in radii r. Fragments may overlap by as much."""
N_GAP_SAMPLES = 12
"""Number of points of a gap at which the surface is examined."""
AHEAD_RADII = np.linspace(0.5, 2.5, 5)
"""Distances of the examined points ahead of an end, in radii r."""
CURVATURE_SHARES = (0.0, 0.5, 1.0)
"""Shares of the curvature of the ends with which the misfit is computed. The curvatures are inaccurate."""
CURVATURE_COST = 0.3
"""Cost of the full curvature, in squared sigmas."""
POSITION_SIGMA_RADII = 0.4
"""Standard deviation of the position of an end, in radii r."""
POSITION_SIGMA_PER_GAP = 0.06
"""Growth of the standard deviation of the position in the middle of a gap, per length of the gap."""
DIRECTION_SIGMA_RAD = 0.2
"""Standard deviation of the direction of an end, radians."""
DIRECTION_SIGMA_RAD_PER_RADIUS = 0.06
"""Growth of the standard deviation of the direction in the middle of a gap, radians per radius r of the gap."""
SAME_POINT_M = 1e-9
"""Maximum distance of two ends at the same point, metres. The direction from one to the other is undefined."""
MIN_LENGTH = 1e-12
"""Lower limit of the length by which a vector is divided. It keeps zero vectors zero."""
MIN_TANGENT = 1e-9
"""The same for the sum of two unit vectors."""
MAX_BARE_GAP_RADII = 1.0
"""Maximum length of bare table in a gap, in radii r. Noise causes shorter holes. Bare table cannot hide a string."""
MIN_CERTAIN_MARGIN = 2.0
"""A pair is ambiguous if its exclusion raises the minimum total cost by less than this value."""


@dataclass(frozen=True, eq=False)
class FragmentEnds:
    """The two ends of every open fragment. The first point of a fragment comes before the last point."""

    fragment: NDArray[np.int64]
    """(N,) index of the fragment of each end."""
    points: NDArray[np.float64]
    """(N, 3) smoothed positions of the ends, metres, base frame."""
    directions: NDArray[np.float64]
    """(N, 3) unit vectors pointing out of the fragment."""
    curvatures: NDArray[np.float64]
    """(N, 3) curvature vectors, perpendicular to the directions, 1/m."""

    def extrapolate(
        self, indices: NDArray[np.int64], distance: NDArray[np.float64], curvature_share: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Extrapolate fragments beyond their ends.

        Args:
            indices: (M,) indices of the ends.
            distance: (M,) distance to extrapolate from each end, metres.
            curvature_share: Share of the curvature that is used, 0 to 1.

        Returns:
            The extrapolated points (M, 3), metres, base frame, and the unit directions (M, 3) at these points.
        """
        curve = curvature_share * self.curvatures[indices] * distance[:, None]
        points = self.points[indices] + distance[:, None] * (self.directions[indices] + curve / 2)
        directions = self.directions[indices] + curve
        return points, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class AmbiguousPair:
    """A pair of ends that was joined, although another solution costs hardly more."""

    points: NDArray[np.float64]
    """(2, 3) positions of the two ends, metres, base frame."""
    margin: float
    """Rise of the minimum total cost without this pair, in squared sigmas. It is below `MIN_CERTAIN_MARGIN`."""


@dataclass(frozen=True, eq=False)
class Pairing:
    """Pairs of fragment ends to join."""

    ends: FragmentEnds
    """Ends of all open fragments."""
    pairs: list[tuple[int, int]]
    """Indices into `ends` of the two ends of each pair."""
    ambiguous: list[AmbiguousPair]
    """Pairs that may be wrong (see `MIN_CERTAIN_MARGIN`)."""
    bridges: Mapping[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    """(N, 3) points between the two ends of each pair that bends under another strand, metres, base frame."""

    @property
    def bends(self) -> NDArray[np.float64]:
        """(B, 3) points of all strands where they bend under another strand, metres, base frame."""
        return np.vstack([np.empty((0, 3)), *self.bridges.values()])


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Pairs of ends that may be joined."""

    a: NDArray[np.int64]
    """(M,) index of the first end of each pair."""
    b: NDArray[np.int64]
    """(M,) index of the second end of each pair."""
    cost: NDArray[np.float64]
    """(M,) cost of each pair, in squared sigmas."""
    bend: NDArray[np.int64]
    """(M,) index of the hidden bend that explains each pair, -1 for none."""
    conflicts: NDArray[np.int64]
    """(L, 2) indices of pairs that cannot both be joined."""

    def select(self, mask: NDArray[np.bool_]) -> "_Candidates":
        """Return the pairs in a mask (M,), and the conflicts between them."""
        new_index = np.cumsum(mask) - 1
        is_kept = mask[self.conflicts].all(axis=1)
        return _Candidates(
            a=self.a[mask],
            b=self.b[mask],
            cost=self.cost[mask],
            bend=self.bend[mask],
            conflicts=new_index[self.conflicts[is_kept]],
        )


def pair_ends(
    fragments: Sequence[Fragment], occlusion_map: OcclusionMap, parameters: ChainParameters, table_z_m: float = 0.0
) -> Pairing:
    """Pair the fragment ends of the whole scene at the minimum total cost.

    The cost of a pair is its misfit plus the cost of its gap. The two ends are extrapolated to the middle of the gap.
    The misfit is their difference in position and direction there, in squared sigmas.

    An end without a partner also has a cost. It is higher if another strand lies over the continuation of the end. A
    maximum weight matching selects the pairs.

    Args:
        fragments: Fragments of the scene.
        occlusion_map: Occlusion map of the registered surface.
        parameters: Method parameters; uses the radius r.
        table_z_m: Height of the table, metres, base frame.

    Returns:
        The ends, the pairs, and the ambiguous pairs.

    Source:
        Generalises section III.E.2, eq. (8). Eq. (8) sums v_j . v_k over the two pairs of the four ends at one
        intersection. The total cost here sums over all pairs of the scene. The costs are not in the paper.
    """
    ends = _collect_ends(fragments, parameters.r)
    if len(ends.points) < 2:
        return Pairing(ends, [], [])
    r = parameters.r
    pairs = _candidate_pairs(ends, fragments, r)
    strings = VisibleStrings(fragments, occlusion_map.surface, r, table_z_m)
    cost = _misfit(ends, pairs, r) + _gap_cost(ends, pairs, occlusion_map, strings, r)
    bends = find_hidden_bends(ends.fragment, fragments, strings, occlusion_map, r)
    candidates = _with_bends(pairs, cost, bends)
    occluded_share = _occluded_share_ahead(ends, occlusion_map, r)
    single_cost = UNPAIRED_END_COST + OCCLUDED_END_COST * np.maximum(occluded_share, bends.is_hidden_ahead)
    gain = single_cost[candidates.a] + single_cost[candidates.b] - candidates.cost
    return _match(ends, candidates.select(gain > 0), gain[gain > 0], bends)


def _match(ends: FragmentEnds, candidates: _Candidates, gain: NDArray[np.float64], bends: HiddenBends) -> Pairing:
    """Return the pairs with the largest sum of gains. `gain` (M,) is the gain of each candidate."""
    a = candidates.a
    b = candidates.b
    matched = matching_without_conflicts(a, b, gain, candidates.conflicts)
    margins = matching_margins(matched, a, b, gain, candidates.conflicts)
    pairs = []
    ambiguous = []
    bridges = {}
    for k, margin in zip(matched, margins, strict=True):
        pair = (int(a[k]), int(b[k]))
        pairs.append(pair)
        if margin < MIN_CERTAIN_MARGIN:
            ambiguous.append(AmbiguousPair(ends.points[list(pair)], float(margin)))
        bend = candidates.bend[k]
        if bend >= 0:
            bridges[pair] = bends.curves[bend, 1:-1]
    return Pairing(ends, pairs, ambiguous, bridges)


def _collect_ends(fragments: Sequence[Fragment], r: float) -> FragmentEnds:
    fragment_of_end = []
    fitted = []
    for index, fragment in enumerate(fragments):
        if fragment.closed:
            continue
        for line in (fragment.points, fragment.points[::-1]):
            fragment_of_end.append(index)
            fitted.append(_fit_end(line, r))
    # The positions, the directions and the curvatures of all ends.
    points, directions, curvatures = np.array(fitted).reshape(-1, 3, 3).swapaxes(0, 1).copy()
    return FragmentEnds(np.array(fragment_of_end, dtype=np.int64), points, directions, curvatures)


def _fit_end(
    points: NDArray[np.float64], r: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Estimate the end of a line from a parabola that is fitted to the first part of the line.

    Args:
        points: (N, 3) points of the line, metres. The end is the first point.
        r: Radius of the string, metres.

    Returns:
        Fitted position (3,) of the end, outward unit direction (3,) and curvature vector (3,), 1/m.
    """
    terms = fit_end_parabola(points, END_FIT_RADII * r, r)
    position, velocity, bend = terms
    direction = -velocity / max(float(np.linalg.norm(velocity)), MIN_LENGTH)
    curvature = 2 * bend - 2 * (bend @ direction) * direction
    # No bend is tighter than the minimum bend radius.
    excess = float(np.linalg.norm(curvature)) * MIN_BEND_RADII * r
    return position, direction, curvature / max(1.0, excess)


def _candidate_pairs(ends: FragmentEnds, fragments: Sequence[Fragment], r: float) -> NDArray[np.int64]:
    """Return the end indices (M, 2) of the candidate pairs: ends that are near and roughly face each other."""
    a, b = np.triu_indices(len(ends.points), 1)
    may_close = np.array([arc_length(f.points)[-1] > MIN_RING_RADII * r for f in fragments], dtype=bool)
    offset = ends.points[b] - ends.points[a]
    gap = np.linalg.norm(offset, axis=1)
    is_near = (gap <= MAX_GAP_RADII * r) & ((ends.fragment[a] != ends.fragment[b]) | may_close[ends.fragment[a]])
    turn = np.maximum(_angle(offset, ends.directions[a]), _angle(-offset, ends.directions[b]))
    is_candidate = is_near & ((turn < MAX_TURN_RAD) | (gap < SAME_POINT_M))
    return np.column_stack([a, b])[is_candidate]


def _with_bends(pairs: NDArray[np.int64], cost: NDArray[np.float64], bends: HiddenBends) -> _Candidates:
    """Return the pairs (M, 2) with their costs (M,), and those of the hidden bends.

    A pair with a hidden bend gets the lower one of both costs.
    """
    all_pairs = np.concatenate([pairs, np.column_stack([bends.a, bends.b])])
    unique_pairs, index = np.unique(all_pairs, axis=0, return_inverse=True)
    index_of_pair = index[: len(pairs)]
    index_of_bend = index[len(pairs) :]
    lowest = np.full(len(unique_pairs), np.inf)
    lowest[index_of_pair] = cost
    is_cheaper = bends.cost < lowest[index_of_bend]
    bend = np.full(len(unique_pairs), -1)
    bend[index_of_bend[is_cheaper]] = np.flatnonzero(is_cheaper)
    lowest[index_of_bend[is_cheaper]] = bends.cost[is_cheaper]
    a, b = unique_pairs.T
    return _Candidates(a, b, lowest, bend, conflicts=index_of_bend[bends.conflicts])


def _misfit(ends: FragmentEnds, pairs: NDArray[np.int64], r: float) -> NDArray[np.float64]:
    """Return the misfit (M,) of each pair of ends (M, 2) in the middle of its gap, in squared sigmas.

    The curvatures of the ends are inaccurate. The misfit is therefore computed with no, half and full curvature, and
    the smallest result is used.
    """
    a, b = pairs.T
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    position_sigma = POSITION_SIGMA_RADII * r + POSITION_SIGMA_PER_GAP * gap
    direction_sigma = DIRECTION_SIGMA_RAD + DIRECTION_SIGMA_RAD_PER_RADIUS * gap / r
    misfits = []
    for share in CURVATURE_SHARES:
        p, u = ends.extrapolate(a, gap / 2, share)
        q, v = ends.extrapolate(b, gap / 2, share)
        tangent = u - v
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), MIN_TANGENT)
        offset = p - q
        offset = offset - (offset * tangent).sum(axis=1, keepdims=True) * tangent
        offset[:, 2] *= HEIGHT_WEIGHT
        position_sigmas = np.linalg.norm(offset, axis=1) / position_sigma
        direction_sigmas = _angle(u, -v) / direction_sigma
        misfits.append(position_sigmas**2 + direction_sigmas**2 + CURVATURE_COST * share)
    return np.min(misfits, axis=0)


def _gap_cost(
    ends: FragmentEnds, pairs: NDArray[np.int64], occlusion_map: OcclusionMap, strings: VisibleStrings, r: float
) -> NDArray[np.float64]:
    """Return the cost (M,) of the gap of each pair of ends (M, 2).

    The cost is infinite if the gap leads over more bare table than `MAX_BARE_GAP_RADII`.
    """
    if len(pairs) == 0:
        return np.empty(0)
    a, b = pairs.T
    gap = np.linalg.norm(ends.points[b] - ends.points[a], axis=1)
    # A cubic Hermite spline whose tangents are as long as the gap, as an array (M, N, 3).
    t = np.linspace(0, 1, N_GAP_SAMPLES + 2)[None, 1:-1, None]
    length = gap[:, None, None]
    leaving = ends.directions[a, None] * length
    arriving = -ends.directions[b, None] * length
    from_start = 2 * t**3 - 3 * t**2 + 1
    curve = (
        from_start * ends.points[a, None]
        + (t**3 - 2 * t**2 + t) * leaving
        + (1 - from_start) * ends.points[b, None]
        + (t**3 - t**2) * arriving
    )
    occlusion = occlusion_map.occlusion(curve.reshape(-1, 3), r)
    occluded_share = occlusion.is_occluded.reshape(len(pairs), -1).mean(axis=1)
    bare_share = occlusion.is_uncovered.reshape(len(pairs), -1).mean(axis=1)
    visible_radii = np.maximum((1 - occluded_share) * gap / r - FREE_VISIBLE_GAP_RADII, 0.0)
    cost = GAP_COST_PER_RADIUS * gap / r + VISIBLE_GAP_COST_PER_RADIUS * visible_radii
    along_radii = strings.length_along(curve, pairs, ends.fragment) / r
    cost += ALONG_COST_PER_RADIUS * np.maximum(along_radii - FREE_ALONG_RADII, 0.0)
    return np.where(bare_share * gap > MAX_BARE_GAP_RADII * r, np.inf, cost)


def _occluded_share_ahead(ends: FragmentEnds, occlusion_map: OcclusionMap, r: float) -> NDArray[np.float64]:
    """Return the occluded share (N,) of the points `AHEAD_RADII` ahead of each end, 0 to 1."""
    distance = AHEAD_RADII[None, :, None] * r
    horizontal = ends.directions * (1, 1, 0)
    points = ends.points[:, None] + distance * horizontal[:, None]
    is_occluded = occlusion_map.occlusion(points.reshape(-1, 3), r).is_occluded
    return is_occluded.reshape(len(ends.points), -1).mean(axis=1)


def _angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (M,) between the vectors `a` and `b` (M, 3), radians. `HEIGHT_WEIGHT` scales their z."""
    a = a * (1, 1, HEIGHT_WEIGHT)
    b = b * (1, 1, HEIGHT_WEIGHT)
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    cosine = (a * b).sum(axis=1) / np.maximum(lengths, MIN_LENGTH)
    return np.arccos(np.clip(cosine, -1, 1))
