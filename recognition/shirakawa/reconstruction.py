"""Reconstruction of the point chain model (section III.E): joins segments to strands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from recognition.errors import TooCrowdedError
from recognition.geometry.graph_matching import maximum_weight_matching
from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.strand import End, Strand, join_strands, strand_ends

Points = NDArray[np.float64]

MAX_JOIN_COSINE = -0.5
"""Ends continue one another only if the inner product of their directions is smaller (angle above 120 degrees)."""
MAX_INTERSECTION_COSINE = 0.5
"""Limit of that product at an intersection, where eq. (8) chooses: only pairs that fold back are excluded."""
MIN_FACING_COSINE = 0.5
"""An end faces a point if the point is within 60 degrees of the end's direction. This is the cosine of that angle."""
MAX_SEGMENTS = 2000
"""Maximum number of segments: a string of ten metres with a hundred crossings has a few hundred."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The strands after each of the two steps of the reconstruction."""

    reconnected: list[Strand]
    """After the reconnection of close ends (III.E.1)."""
    connected: list[Strand]
    """After the connection of the ends at intersections (III.E.2)."""


def reconstruct(
    segments: Sequence[Points], centres: Points, surface: Points, parameters: ChainParameters
) -> Reconstruction:
    """Join segments to strands: close ends first, then the ends around intersections.

    Args:
        segments: (N, 3) points of each segment, metres. Empty segments are ignored.
        centres: (M, 3) bifurcation centres, metres.
        surface: (K, 3) registered surface points, metres, base frame. They show where a strand may be hidden.
        parameters: Radii of Table I.

    Returns:
        The strands after each step.

    Raises:
        TooCrowdedError: There are more segments than strings can have (`MAX_SEGMENTS`).

    Source:
        Section III.E. Ours are `split_at_side_contacts` and `connect_across_gaps`.
    """
    if len(segments) > MAX_SEGMENTS:
        raise TooCrowdedError(
            f"the points above the table fall into {len(segments)} pieces, too many for strings: check the radius of "
            "the string and the workspace"
        )
    strands = [Strand(points, np.zeros(len(points), dtype=bool)) for points in segments if len(points)]
    reconnected = reconnect_close_ends(strands, centres, parameters)
    opened, centres = split_at_side_contacts(reconnected, centres, parameters)
    at_centres = connect_at_intersections(opened, centres, parameters)
    return Reconstruction(reconnected, connect_across_gaps(at_centres, surface, parameters))


def reconnect_close_ends(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Strand]:
    """Join ends that are closer than r_f, the closest pair first.

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Radius r_f, and radii of the intersections.

    Returns:
        The joined strands.

    Source:
        Section III.E.1. The paper joins every pair. Ours excludes pairs whose directions are not opposite, because two
        strings may end side by side. It also excludes ends that gather around a bifurcation centre, because eq. (8)
        decides which of those belong together, not their distance.
    """
    ends = strand_ends(strands, parameters)
    at_intersection = assign_to_intersections(ends, centres, parameters) >= 0
    has_direction = np.array([end.direction.any() for end in ends], dtype=bool)
    D = np.linalg.norm(_positions(ends)[:, None] - _positions(ends)[None], axis=2)
    # A strand of one point has no direction and may be joined on either side.
    opposite = (inner_products(ends) < MAX_JOIN_COSINE) | ~has_direction[:, None] | ~has_direction[None]
    pairs = []
    used = set(np.flatnonzero(at_intersection).tolist())
    j, k = np.triu_indices(len(ends), 1)
    for n in np.argsort(D[j, k], kind="stable"):
        first, second = int(j[n]), int(k[n])
        if D[first, second] >= parameters.r_f:
            break
        if (
            {first, second} & used
            or not opposite[first, second]
            or not _may_join(ends, first, second, strands, parameters)
        ):
            continue
        pairs.append((first, second))
        used |= {first, second}
    return join_strands(strands, ends, pairs, parameters)


def split_at_side_contacts(
    strands: Sequence[Strand], centres: Points, parameters: ChainParameters
) -> tuple[list[Strand], Points]:
    """Cut strands where the end of another strand meets their side.

    Such an end marks an intersection that R_c did not show: a sequence turned from one strand into the other and left
    the rest of both. The passing strand is opened over r_cn, so that eq. (8) can decide which of the ends belong
    together. Where a string really ends on another, eq. (8) closes the opening again.

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Radii r_f and r_cn, and radii of the intersections.

    Returns:
        The strands without the points within r_cn of a contact, and the centres with the contacts added.

    Source:
        Ours.
    """
    ends = strand_ends(strands, parameters)
    away_from_centres = assign_to_intersections(ends, centres, parameters) < 0
    owner = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    points = np.vstack([np.empty((0, 3)), *(strand.points for strand in strands)])
    arc_lengths = [arc_length(strand.points) for strand in strands]
    s = np.concatenate([[], *arc_lengths])
    length = np.array([along[-1] for along in arc_lengths])
    closed = np.array([strand.closed for strand in strands], dtype=bool)
    is_side = closed[owner] | ((s > parameters.r_f) & (s < length[owner] - parameters.r_f))
    tree = KDTree(points)
    contacts = []
    for end in (end for end, is_away in zip(ends, away_from_centres, strict=True) if is_away):
        near = np.asarray(tree.query_ball_point(end.point, parameters.r_f, return_sorted=True), dtype=np.int64)
        # The points of the end's own strand next to the end are not the side of another strand.
        own = (owner[near] == end.strand) & (
            (s[near] if end.at_start else length[end.strand] - s[near]) <= parameters.r_cn
        )
        offset = points[near] - end.point
        distance = np.linalg.norm(offset, axis=1)
        is_contact = is_side[near] & ~own & (offset @ end.direction > MIN_FACING_COSINE * distance)
        if is_contact.any():
            contacts.append(points[near[is_contact][distance[is_contact].argmin()]])
    if not contacts:
        return list(strands), centres
    contact_tree = KDTree(np.array(contacts))
    opened = []
    for strand in strands:
        clear = contact_tree.query(strand.points)[0] >= parameters.r_cn
        for run in np.split(np.arange(len(clear)), np.flatnonzero(np.diff(clear)) + 1):
            if clear[run[0]]:
                opened.append(Strand(strand.points[run], strand.bridged[run], strand.closed and len(run) == len(clear)))
    return opened, np.vstack([centres, contacts])


def connect_at_intersections(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Strand]:
    """Join the ends that gather around each intersection by eq. (8).

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Radii of the intersections.

    Returns:
        The joined strands.

    Source:
        Section III.E.2, eq. (8). Excluding pairs that fold back (`MAX_INTERSECTION_COSINE`) is ours.
    """
    ends = strand_ends(strands, parameters)
    intersection = assign_to_intersections(ends, centres, parameters)
    same = (intersection[:, None] == intersection[None]) & (intersection >= 0)[:, None]
    allowed = same & (inner_products(ends) < MAX_INTERSECTION_COSINE)
    return join_strands(strands, ends, straightest_pairs(ends, allowed, strands, parameters), parameters)


def assign_to_intersections(ends: Sequence[End], centres: Points, parameters: ChainParameters) -> NDArray[np.int64]:
    """Return the number of the intersection around which each end gathers.

    An end gathers around the nearest centre if it points towards it from within r_cf + r_n: an incoming sequence or a
    restart can be as far away as that. Centres are one intersection if their inner spheres (r_cn) overlap, because
    nothing of the strands between them is left. This includes two centres of strands that cross at an acute angle.

    Args:
        ends: The N ends of the strands.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Radii r_cn, r_cf and r_n.

    Returns:
        (N,) number of the intersection, -1 for none.

    Source:
        Section III.E.2 speaks of the ends "which gather around an intersection". The rule is ours.
    """
    if len(ends) == 0 or len(centres) == 0:
        return np.full(len(ends), -1)
    _, intersection = connected_components(
        np.linalg.norm(centres[:, None] - centres[None], axis=2) < 2 * parameters.r_cn, directed=False
    )
    to_centre = centres[None] - _positions(ends)[:, None]
    D = np.linalg.norm(to_centre, axis=2)
    nearest = D.argmin(axis=1)
    rows = np.arange(len(ends))
    towards = (to_centre[rows, nearest] * _directions(ends)).sum(axis=1)
    gathers = (D[rows, nearest] <= parameters.r_cf + parameters.r_n) & (towards > 0)
    return np.where(gathers, intersection[nearest], -1)


def connect_across_gaps(strands: Sequence[Strand], surface: Points, parameters: ChainParameters) -> list[Strand]:
    """Join ends that face each other across a gap in which another strand hides the string, by eq. (8).

    Where strands lie on one another without being merged, the contribution rate stays high. No bifurcation centre is
    found, and the hidden strand has a gap. Its two ends belong to an intersection too. Ends without `surface` between
    them are not joined.

    Args:
        strands: Strands of the scene.
        surface: (K, 3) registered surface points, metres, base frame.
        parameters: Radii r, r_f and r_cf. Gaps are at most 2 r_cf long.

    Returns:
        The joined strands.

    Source:
        Ours, an addition to section III.E.2.
    """
    ends = strand_ends(strands, parameters)
    if len(ends) < 2:
        return list(strands)
    offset = _positions(ends)[None] - _positions(ends)[:, None]
    D = np.linalg.norm(offset, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("jkx,jx->jk", offset, _directions(ends)) / D
    facing = np.nan_to_num(cosine, nan=-1.0) > MIN_FACING_COSINE
    near = np.less_equal(D, 2 * parameters.r_cf)
    allowed = near & facing & facing.T & (inner_products(ends) < MAX_JOIN_COSINE)
    surface_xy = KDTree(surface[:, :2])
    for j, k in zip(*np.nonzero(np.triu(allowed, 1)), strict=True):
        allowed[j, k] = allowed[k, j] = _is_covered(ends[j].point, ends[k].point, surface_xy, parameters)
    return join_strands(strands, ends, straightest_pairs(ends, allowed, strands, parameters), parameters)


def straightest_pairs(
    ends: Sequence[End], allowed: NDArray[np.bool_], strands: Sequence[Strand], parameters: ChainParameters
) -> list[tuple[int, int]]:
    """Return the pairs of ends that have the minimum total of eq. (8).

    Args:
        ends: The N ends of the strands.
        allowed: (N, N) whether two ends may be a pair; symmetric.
        strands: Strands of the scene.
        parameters: Radius r_f, for strands that may close on themselves.

    Returns:
        Indices of the two ends of each pair. Each end is in one pair or in none.

    Source:
        Section III.E.2. Eq. (8) adds v_j . v_k over the two pairs of four ends. Ours adds it over the pairs of any
        number of ends. As many ends as possible are paired, so that only odd ends remain; among the sets of that size,
        the one with the minimum total is taken.
    """
    b = inner_products(ends)
    j, k = np.nonzero(np.triu(allowed, 1))
    pairs = [
        (int(a), int(c)) for a, c in zip(j, k, strict=True) if _may_join(ends, int(a), int(c), strands, parameters)
    ]
    if not pairs:
        return []
    j, k = np.array(pairs).T
    # Inner products do not exceed 1, so with this gain no total makes up for a missing pair.
    chosen = maximum_weight_matching(j, k, len(ends) + 2.0 - b[j, k])
    return list(zip(j[chosen].tolist(), k[chosen].tolist(), strict=True))


def inner_products(ends: Sequence[End]) -> NDArray[np.float64]:
    """Return the inner products v_j . v_k of the directions of all pairs of ends.

    Args:
        ends: The N ends of the strands.

    Returns:
        (N, N) values from -1, where the second end continues the first straight, to 1.

    Source:
        Eq. (8), the terms of the sum.
    """
    v = _directions(ends)
    return v @ v.T


def _may_join(ends: Sequence[End], j: int, k: int, strands: Sequence[Strand], parameters: ChainParameters) -> bool:
    """Return whether two ends may be joined: a strand must be long enough to close on itself."""
    if ends[j].strand != ends[k].strand:
        return True
    return bool(arc_length(strands[ends[j].strand].points)[-1] > 2 * np.pi * parameters.r_f)


def _is_covered(a: Points, b: Points, surface_xy: KDTree, parameters: ChainParameters) -> bool:
    """Return whether surface lies over the gap from a to b, seen from above.

    The means of eqs. (2) and (3) move each end back by up to 2 r = r_f from where the strand disappears. The part of
    the gap that is farther than that from both ends must be covered, at least its middle.
    """
    length = float(np.linalg.norm(b - a))
    covered_length = max(length - 2 * parameters.r_f, 0.0)
    share = 0.5 + np.linspace(-0.5, 0.5, 9) * covered_length / length
    positions = a[:2] + share[:, None] * (b - a)[:2]
    distance, _ = surface_xy.query(positions)
    return bool((distance < parameters.r).all())


def _positions(ends: Sequence[End]) -> Points:
    """Return (N, 3) the positions of the ends."""
    return np.array([end.point for end in ends]).reshape(-1, 3)


def _directions(ends: Sequence[End]) -> Points:
    """Return (N, 3) the outward directions of the ends."""
    return np.array([end.direction for end in ends]).reshape(-1, 3)
