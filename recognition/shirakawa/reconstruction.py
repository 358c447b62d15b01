"""Reconstruction of the point chain model (section III.E): join segments to strands."""

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
"""Maximum inner product of the outward directions of two ends that continue each other (angle above 120 degrees)."""
MAX_INTERSECTION_COSINE = 0.5
"""Maximum inner product of the outward directions of two ends of an intersection (angle above 60 degrees).

The limit only excludes pairs that fold back. Eq. (8) chooses among the other pairs.
"""
MIN_FACING_COSINE = 0.5
"""An end faces a point if the cosine between the outward direction and the direction to the point exceeds this value.

The angle is then less than 60 degrees.
"""
N_GAP_SAMPLES = 9
"""Number of points of a gap at which the surface is examined."""
MAX_SEGMENTS = 2000
"""Maximum number of segments. A string of ten metres with a hundred crossings has a few hundred."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The strands after each of the two steps of the reconstruction."""

    reconnected: list[Strand]
    """Strands after close ends were joined (III.E.1)."""
    connected: list[Strand]
    """Strands after ends were also joined at intersections (III.E.2) and across gaps."""


def reconstruct(
    segments: Sequence[Points], centres: Points, surface: Points, parameters: ChainParameters
) -> Reconstruction:
    """Join segments to strands: close ends first, then the ends around intersections.

    Args:
        segments: (N, 3) points of each segment, metres. Empty segments are ignored.
        centres: (M, 3) bifurcation centres, metres.
        surface: (K, 3) registered surface points, metres, base frame. They show which gaps another strand covers.
        parameters: Method parameters; uses r, r_n, r_f, r_cn and r_cf.

    Returns:
        The strands after each step.

    Raises:
        TooCrowdedError: The number of segments exceeds `MAX_SEGMENTS`.

    Source:
        Section III.E. `split_at_side_contacts` and `connect_across_gaps` are not in the paper.
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
    """Join pairs of ends that are closer than r_f, the closest pair first.

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Method parameters; uses r_f, r_n, r_cn and r_cf.

    Returns:
        The joined strands.

    Source:
        Section III.E.1. The paper joins every pair of close ends. Here, the two directions must be opposite, because
        two strings may end side by side. Ends of an intersection are also excluded, because eq. (8) pairs these ends
        later.
    """
    ends = strand_ends(strands, parameters)
    at_intersection = assign_to_intersections(ends, centres, parameters) >= 0
    has_direction = np.array([end.direction.any() for end in ends], dtype=bool)
    D = np.linalg.norm(_positions(ends)[:, None] - _positions(ends)[None], axis=2)
    # A strand of one point has no direction, so its ends may be joined in any direction.
    opposite = (inner_products(ends) < MAX_JOIN_COSINE) | ~has_direction[:, None] | ~has_direction[None]
    pairs = []
    used = set(np.flatnonzero(at_intersection).tolist())
    j, k = np.triu_indices(len(ends), 1)
    for n in np.argsort(D[j, k], kind="stable"):
        pair = (int(j[n]), int(k[n]))
        if D[pair] >= parameters.r_f:
            break
        if used.isdisjoint(pair) and opposite[pair] and _may_join(ends, pair, strands, parameters):
            pairs.append(pair)
            used.update(pair)
    return join_strands(strands, ends, pairs, parameters)


def split_at_side_contacts(
    strands: Sequence[Strand], centres: Points, parameters: ChainParameters
) -> tuple[list[Strand], Points]:
    """Cut each strand where an end touches the side of the strand.

    A side contact marks an intersection that R_c did not show: a matching sequence turned from one strand into another.
    The points within r_cn of the contact are removed, so that eq. (8) can choose among all ends there. If a string
    really ends at the side of another string, eq. (8) closes the cut again.

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Method parameters; uses r_f, r_n, r_cn and r_cf.

    Returns:
        The cut strands, and the centres (M + C, 3) with the C contact points appended.
    """
    contacts = _find_side_contacts(strands, centres, parameters)
    if not contacts:
        return list(strands), centres
    contact_tree = KDTree(np.array(contacts))
    opened = []
    for strand in strands:
        distance, _ = contact_tree.query(strand.points)
        is_clear = distance >= parameters.r_cn
        for run in np.split(np.arange(len(is_clear)), np.flatnonzero(np.diff(is_clear)) + 1):
            if is_clear[run[0]]:
                is_whole = len(run) == len(is_clear)
                opened.append(Strand(strand.points[run], strand.bridged[run], strand.closed and is_whole))
    return opened, np.vstack([centres, contacts])


def _find_side_contacts(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Points]:
    """Return the points (3,) of sides of strands that ends away from the `centres` (M, 3) touch."""
    ends = strand_ends(strands, parameters)
    intersection = assign_to_intersections(ends, centres, parameters)
    arc_lengths = [arc_length(strand.points) for strand in strands]
    length = np.array([along[-1] for along in arc_lengths])
    closed = np.array([strand.closed for strand in strands], dtype=bool)
    # All points of all strands, with their strand, their arc length and whether they are away from its ends.
    points = np.vstack([np.empty((0, 3)), *(strand.points for strand in strands)])
    owner = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    s = np.concatenate([[], *arc_lengths])
    is_side = closed[owner] | ((s > parameters.r_f) & (s < length[owner] - parameters.r_f))
    tree = KDTree(points)
    contacts = []
    for k in np.flatnonzero(intersection < 0):
        end = ends[k]
        near = np.asarray(tree.query_ball_point(end.point, parameters.r_f, return_sorted=True), dtype=np.int64)
        # Exclude the points of the same strand that are next to the end itself.
        from_end = s[near] if end.at_start else length[end.strand] - s[near]
        is_own = (owner[near] == end.strand) & (from_end <= parameters.r_cn)
        offset = points[near] - end.point
        distance = np.linalg.norm(offset, axis=1)
        is_ahead = offset @ end.direction > MIN_FACING_COSINE * distance
        is_contact = is_side[near] & ~is_own & is_ahead
        if is_contact.any():
            nearest = near[is_contact][distance[is_contact].argmin()]
            contacts.append(points[nearest])
    return contacts


def connect_at_intersections(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Strand]:
    """Join the ends around each intersection, in pairs chosen by eq. (8).

    Args:
        strands: Strands of the scene.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Method parameters; uses r_f, r_n, r_cn and r_cf.

    Returns:
        The joined strands.

    Source:
        Section III.E.2, eq. (8). The exclusion of pairs that fold back (`MAX_INTERSECTION_COSINE`) is not in the paper.
    """
    ends = strand_ends(strands, parameters)
    intersection = assign_to_intersections(ends, centres, parameters)
    same = (intersection[:, None] == intersection[None]) & (intersection >= 0)[:, None]
    allowed = same & (inner_products(ends) < MAX_INTERSECTION_COSINE)
    return join_strands(strands, ends, straightest_pairs(ends, allowed, strands, parameters), parameters)


def assign_to_intersections(ends: Sequence[End], centres: Points, parameters: ChainParameters) -> NDArray[np.int64]:
    """Return the index of the intersection to which each end belongs.

    An end belongs to the nearest bifurcation centre if the end points towards the centre and lies within r_cf + r_n of
    the centre. An incoming sequence or a restart can be this far away.

    Several centres form one intersection if their inner spheres (r_cn) overlap, because no piece of a strand is left
    between these centres. For example, two strands that cross at an acute angle may have two centres.

    Args:
        ends: The N ends of the strands.
        centres: (M, 3) bifurcation centres, metres.
        parameters: Method parameters; uses the radii r_cn, r_cf and r_n.

    Returns:
        (N,) index of the intersection, -1 for none.

    Source:
        Section III.E.2: the ends "which gather around an intersection". The paper does not define this condition.
    """
    if len(ends) == 0 or len(centres) == 0:
        return np.full(len(ends), -1)
    overlaps = np.linalg.norm(centres[:, None] - centres[None], axis=2) < 2 * parameters.r_cn
    _, intersection = connected_components(overlaps, directed=False)
    to_centre = centres[None] - _positions(ends)[:, None]
    D = np.linalg.norm(to_centre, axis=2)
    nearest = D.argmin(axis=1)
    rows = np.arange(len(ends))
    towards = (to_centre[rows, nearest] * _directions(ends)).sum(axis=1)
    gathers = (D[rows, nearest] <= parameters.r_cf + parameters.r_n) & (towards > 0)
    return np.where(gathers, intersection[nearest], -1)


def connect_across_gaps(strands: Sequence[Strand], surface: Points, parameters: ChainParameters) -> list[Strand]:
    """Join ends that face each other across a gap that another strand covers.

    Two strands may cross without being merged in the data. The contribution rate then stays high, and no bifurcation
    centre is found, but the hidden strand has a gap. Eq. (8) chooses the pairs of ends to join. A gap that no surface
    points cover stays open.

    Args:
        strands: Strands of the scene.
        surface: (K, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses r, r_n, r_f and r_cf. The maximum length of a gap is 2 r_cf.

    Returns:
        The joined strands.

    Source:
        Not in the paper; an addition to section III.E.2.
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
    for j, k in np.argwhere(np.triu(allowed, 1)):
        is_covered = _is_covered(ends[j].point, ends[k].point, surface_xy, parameters)
        allowed[j, k] = is_covered
        allowed[k, j] = is_covered
    return join_strands(strands, ends, straightest_pairs(ends, allowed, strands, parameters), parameters)


def straightest_pairs(
    ends: Sequence[End], allowed: NDArray[np.bool_], strands: Sequence[Strand], parameters: ChainParameters
) -> list[tuple[int, int]]:
    """Return the pairs of ends with the minimum sum of eq. (8).

    The number of pairs is maximised first. Among the solutions with this number, the sum of v_j . v_k over the pairs is
    minimised.

    Args:
        ends: The N ends of the strands.
        allowed: Mask (N, N), symmetric, True where two ends may form a pair.
        strands: Strands of the scene.
        parameters: Method parameters; uses r_f for the minimum length of a strand that closes on itself.

    Returns:
        Indices of the two ends of each pair. Each end is in one pair or in none.

    Source:
        Section III.E.2, eq. (8). The paper pairs four ends; here the number of ends is arbitrary.
    """
    b = inner_products(ends)
    candidates = np.argwhere(np.triu(allowed, 1)).tolist()
    pairs = [(j, k) for j, k in candidates if _may_join(ends, (j, k), strands, parameters)]
    if not pairs:
        return []
    j, k = np.array(pairs).T
    # One more pair gains more than any difference of the sums, so the number of pairs is maximised first.
    chosen = maximum_weight_matching(j, k, len(ends) + 2.0 - b[j, k])
    return [pairs[index] for index in chosen]


def inner_products(ends: Sequence[End]) -> NDArray[np.float64]:
    """Return the inner products v_j . v_k of the directions of all pairs of ends.

    Args:
        ends: The N ends of the strands.

    Returns:
        (N, N) inner products, from -1 to 1. At -1, the two ends continue each other in a straight line.

    Source:
        Terms of the sum in eq. (8).
    """
    v = _directions(ends)
    return v @ v.T


def _may_join(
    ends: Sequence[End], pair: tuple[int, int], strands: Sequence[Strand], parameters: ChainParameters
) -> bool:
    """Return whether a pair of ends may be joined. A strand of at most 2 pi r_f must not close on itself."""
    first, second = (ends[index] for index in pair)
    if first.strand != second.strand:
        return True
    return bool(arc_length(strands[first.strand].points)[-1] > 2 * np.pi * parameters.r_f)


def _is_covered(a: Points, b: Points, surface_xy: KDTree, parameters: ChainParameters) -> bool:
    """Return whether surface points cover the gap between `a` (3,) and `b` (3,), seen from above.

    The means of eqs. (2) and (3) shorten a strand by up to 2 r, which is r_f in Table I. Only the part of the gap that
    is farther than r_f from both ends must therefore be covered. If the gap is shorter than 2 r_f, this part is its
    middle.
    `surface_xy` is the search tree of the surface points in the table plane.
    """
    length = float(np.linalg.norm(b - a))
    covered_length = max(length - 2 * parameters.r_f, 0.0)
    share = 0.5 + np.linspace(-0.5, 0.5, N_GAP_SAMPLES) * covered_length / length
    positions = a[:2] + share[:, None] * (b - a)[:2]
    distance, _ = surface_xy.query(positions)
    return bool((distance < parameters.r).all())


def _positions(ends: Sequence[End]) -> Points:
    """Return the positions (N, 3) of the ends, metres."""
    return np.array([end.point for end in ends]).reshape(-1, 3)


def _directions(ends: Sequence[End]) -> Points:
    """Return the outward directions (N, 3) of the ends; zero for the ends of a single point."""
    return np.array([end.direction for end in ends]).reshape(-1, 3)
