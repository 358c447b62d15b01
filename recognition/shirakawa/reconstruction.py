"""Reconstruction of the point chain model from segments (section III.E)."""

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
from recognition.strand import End, Strand, join, strand_ends

Points = NDArray[np.float64]

OPPOSITE = -0.5
"""Ends whose directions have a larger inner product (angle under 120 degrees) do not continue one another."""
FACING = 0.5
"""Cosine between an end's direction and the way to its partner: within 60 degrees it faces it."""
MAX_SEGMENTS = 2000
"""Pieces taken; a string of ten metres with a hundred crossings has a few hundred."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The strands after each of the two steps, kept for drawing."""

    reconnected: list[Strand]
    """After close ends were joined (III.E.1)."""
    connected: list[Strand]
    """After the ends at intersections were joined (III.E.2)."""


def reconstruct(
    segments: Sequence[Points], centres: Points, surface: Points, parameters: ChainParameters
) -> Reconstruction:
    """Joins segments (each (N, 3)) to strands: close ends first, then the ends around intersections.

    `centres` (M, 3) are the bifurcation centres, `surface` (K, 3) is the combined cloud, which tells what can
    hide a strand.

    Raises:
        TooCrowdedError: more segments than strings make.
    """
    if len(segments) > MAX_SEGMENTS:
        raise TooCrowdedError(
            f"the points above the table fall into {len(segments)} pieces: check the string's radius and the workspace"
        )
    strands = [Strand(points, np.zeros(len(points), dtype=bool)) for points in segments if len(points)]
    reconnected = reconnect_close_ends(strands, centres, parameters)
    opened, centres = split_at_side_contacts(reconnected, centres, parameters)
    at_centres = connect_at_intersections(opened, centres, parameters)
    return Reconstruction(reconnected, connect_across_gaps(at_centres, surface, parameters))


def reconnect_close_ends(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Strand]:
    """Joins ends closer than r_f, the closest first (III.E.1).

    The paper joins any couple. Here a couple whose directions are not opposite is left alone, since two strings
    may end side by side, and so are ends that gather around a bifurcation centre: which of those belong together
    is for eq. (8) to say, not for their distance.
    """
    ends = strand_ends(strands, parameters)
    at_intersection = intersection_of_ends(ends, centres, parameters) >= 0
    directed = np.array([end.direction.any() for end in ends], dtype=bool)
    D = np.linalg.norm(_positions(ends)[:, None] - _positions(ends)[None], axis=2)
    # A strand of one point has no direction and may be joined on either side.
    opposite = (inner_products(ends) < OPPOSITE) | ~directed[:, None] | ~directed[None]
    pairs = []
    taken = set(np.flatnonzero(at_intersection).tolist())
    j, k = np.triu_indices(len(ends), 1)
    for n in np.argsort(D[j, k], kind="stable"):
        first, second = int(j[n]), int(k[n])
        if D[first, second] >= parameters.r_f:
            break
        if (
            {first, second} & taken
            or not opposite[first, second]
            or not _may_join(ends, first, second, strands, parameters)
        ):
            continue
        pairs.append((first, second))
        taken |= {first, second}
    return join(strands, ends, pairs, parameters)


def split_at_side_contacts(
    strands: Sequence[Strand], centres: Points, parameters: ChainParameters
) -> tuple[list[Strand], Points]:
    """Strands cut where another's end runs into their side, and `centres` (M, 3) with these places added.

    Ours: such an end is an intersection that R_c did not show, at which a sequence has turned from one strand into
    the other and left the rest of both. The strand that passes is opened over r_cn, so that eq. (8) can say which
    of the ends belong together; where a string truly ends on another, it closes the opening again.
    """
    ends = strand_ends(strands, parameters)
    loose = intersection_of_ends(ends, centres, parameters) < 0
    owner = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    points = np.vstack([np.empty((0, 3)), *(strand.points for strand in strands)])
    s = np.concatenate([[], *(arc_length(strand.points) for strand in strands)])
    length = np.array([arc_length(strand.points)[-1] for strand in strands])
    closed = np.array([strand.closed for strand in strands], dtype=bool)
    side = closed[owner] | ((s > parameters.r_f) & (s < length[owner] - parameters.r_f))
    around = KDTree(points)
    contacts = []
    for end in (end for end, is_loose in zip(ends, loose, strict=True) if is_loose):
        near = np.asarray(around.query_ball_point(end.point, parameters.r_f, return_sorted=True), dtype=np.int64)
        # A strand's own points behind its end are no other strand's side.
        behind = (owner[near] == end.strand) & (
            (s[near] if end.at_start else length[end.strand] - s[near]) <= parameters.r_cn
        )
        way = points[near] - end.point
        distance = np.linalg.norm(way, axis=1)
        hit = side[near] & ~behind & (way @ end.direction > FACING * distance)
        if hit.any():
            contacts.append(points[near[hit][distance[hit].argmin()]])
    if not contacts:
        return list(strands), centres
    tree = KDTree(np.array(contacts))
    opened = []
    for strand in strands:
        clear = tree.query(strand.points)[0] >= parameters.r_cn
        for run in np.split(np.arange(len(clear)), np.flatnonzero(np.diff(clear)) + 1):
            if clear[run[0]]:
                opened.append(Strand(strand.points[run], strand.bridged[run], strand.closed and len(run) == len(clear)))
    return opened, np.vstack([centres, contacts])


def connect_at_intersections(strands: Sequence[Strand], centres: Points, parameters: ChainParameters) -> list[Strand]:
    """Joins the ends that gather around each intersection of bifurcation `centres` (M, 3) by eq. (8) (III.E.2)."""
    ends = strand_ends(strands, parameters)
    where = intersection_of_ends(ends, centres, parameters)
    same = (where[:, None] == where[None]) & (where >= 0)[:, None]
    onward = inner_products(ends) < -OPPOSITE
    return join(strands, ends, least_bending_pairs(ends, same & onward, strands, parameters), parameters)


def intersection_of_ends(ends: Sequence[End], centres: Points, parameters: ChainParameters) -> NDArray[np.int64]:
    """(N,) number of the intersection that each end gathers around, -1 for none.

    An end gathers around the nearest centre if that is within r_cf + r_n, as far as an incoming sequence or a
    restart can be from it, and the end points at it. Centres whose inner spheres (r_cn) overlap are one
    intersection, since nothing of the strands between them is left; so are the two places in which strands that
    cross at an acute angle melt together.
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
    """Joins ends that face each other across a gap of at most 2 r_cf in which another strand hides them, by eq. (8).

    Our addition to III.E.2: where strands lie on one another without melting together, the contribution rate
    stays high, no bifurcation centre is found, and the hidden strand just has a gap. Its two ends are an
    intersection's as well. Two ends with nothing of `surface` between them are two ends.
    """
    ends = strand_ends(strands, parameters)
    if len(ends) < 2:
        return list(strands)
    way = _positions(ends)[None] - _positions(ends)[:, None]
    D = np.linalg.norm(way, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("jkx,jx->jk", way, _directions(ends)) / D
    facing = np.nan_to_num(cosine, nan=-1.0) > FACING
    near = np.less_equal(D, 2 * parameters.r_cf)
    allowed = near & facing & facing.T & (inner_products(ends) < OPPOSITE)
    from_above = KDTree(surface[:, :2])
    for j, k in zip(*np.nonzero(np.triu(allowed, 1)), strict=True):
        allowed[j, k] = allowed[k, j] = _hidden(ends[j].point, ends[k].point, from_above, parameters)
    return join(strands, ends, least_bending_pairs(ends, allowed, strands, parameters), parameters)


def _hidden(a: Points, b: Points, from_above: KDTree, parameters: ChainParameters) -> bool:
    """Whether, seen from above, something lies over the gap from a to b.

    The means of eqs. (2) and (3) draw each end back by up to 2 r = r_f from where the strand disappears; all of
    the gap that is farther from both ends, at least its middle, must be covered.
    """
    length = float(np.linalg.norm(b - a))
    bare = max(length - 2 * parameters.r_f, 0.0)
    share = 0.5 + np.linspace(-0.5, 0.5, 9) * bare / length
    places = a[:2] + share[:, None] * (b - a)[:2]
    distance, _ = from_above.query(places)
    return bool((distance < parameters.r).all())


def least_bending_pairs(
    ends: Sequence[End], allowed: NDArray[np.bool_], strands: Sequence[Strand], parameters: ChainParameters
) -> list[tuple[int, int]]:
    """The couples of ends with the least total of eq. (8) among the `allowed` ones ((N, N), symmetric).

    Eq. (8) adds v_j . v_k over the two couples of four ends. Here it adds them over the couples of any number
    of ends, each in one couple at most: as many couples as can be, and among those sets the one of the least
    total, so that only odd ends stay over.
    """
    b = inner_products(ends)
    j, k = np.nonzero(np.triu(allowed, 1))
    couples = [
        (int(a), int(c)) for a, c in zip(j, k, strict=True) if _may_join(ends, int(a), int(c), strands, parameters)
    ]
    if not couples:
        return []
    j, k = np.array(couples).T
    # Inner products are 1 at the most: no total of them makes up for a couple missing.
    taken = maximum_weight_matching(j, k, len(ends) + 2.0 - b[j, k])
    return list(zip(j[taken].tolist(), k[taken].tolist(), strict=True))


def inner_products(ends: Sequence[End]) -> NDArray[np.float64]:
    """(N, N) of v_j . v_k: the evaluation value of each couple in eq. (8), -1 for one that continues straight."""
    v = _directions(ends)
    return v @ v.T


def _may_join(ends: Sequence[End], j: int, k: int, strands: Sequence[Strand], parameters: ChainParameters) -> bool:
    """A strand may close on itself only if it is long enough to come round."""
    if ends[j].strand != ends[k].strand:
        return True
    return bool(arc_length(strands[ends[j].strand].points)[-1] > 2 * np.pi * parameters.r_f)


def _positions(ends: Sequence[End]) -> Points:
    return np.array([end.point for end in ends]).reshape(-1, 3)


def _directions(ends: Sequence[End]) -> Points:
    return np.array([end.direction for end in ends]).reshape(-1, 3)
