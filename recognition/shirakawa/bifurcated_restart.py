"""Bifurcated restart (section III.D): the matching stops at an intersection and starts again beyond it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbour_matrix
from recognition.parameters import ChainParameters
from recognition.shirakawa.matching import SearchField, Segment, next_point

MAX_TURN_RAD = np.radians(75)
"""A string does not turn by more than this within two links: its bend radius would be about r."""


@dataclass(frozen=True, eq=False)
class IntersectionApproach:
    """A matching sequence up to its end or to an intersection.

    Source:
        Section III.D.1.
    """

    segment: Segment
    """Linked points outside the intersection. Empty if the sequence started inside an intersection."""
    bifurcation_centre: NDArray[np.float64] | None
    """(3,) bifurcation centre, metres. None if the sequence ended without an intersection."""


def intersection_ratios(
    points: NDArray[np.float64], in_intersection: NDArray[np.bool_], radius: float
) -> NDArray[np.float64]:
    """Return R_c of each point: the share of intersection points among its neighbours.

    Args:
        points: (N, 3) points, metres.
        in_intersection: (N,) whether a point constitutes an intersection.
        radius: Radius r_f of the neighbourhoods, metres.

    Returns:
        (N,) R_c, from 0 to 1.

    Source:
        Eq. (7).
    """
    A = neighbour_matrix(points, points, radius)
    return (A @ in_intersection.astype(np.float64)) / np.asarray(A.sum(axis=1))


def approach_intersection(
    search: SearchField, R_c: NDArray[np.float64], segment: Segment, parameters: ChainParameters
) -> IntersectionApproach:
    """Continue a segment by the matching method until it ends or reaches an intersection.

    An intersection begins where R_c of a target exceeds R_t. The search continues while R_c does not decrease. The
    point with the largest R_c is the bifurcation centre. The point before R_c first exceeds R_t is the end of the
    segment.

    Args:
        search: Point cloud. Points that the sequence passes become unconnectable.
        R_c: (N,) intersection ratio of each point.
        segment: Points that are linked already, at least one. The list is not changed.
        parameters: Threshold R_t, and radii r_n and r_f.

    Returns:
        The continued segment, and the bifurcation centre if there is one.

    Source:
        Section III.D.1. Two rules are ours. If several points in a row have the same largest R_c, the middle one is the
        bifurcation centre. A turn that no string makes (`find_sharp_turn`) is an intersection too, at which the
        sequence changed to the other strand: the turning point is the bifurcation centre, and the segment ends before
        it.
    """
    segment = list(segment)
    while True:
        if R_c[segment[-1]] > parameters.R_t:
            centre = search.points[_find_largest_ratio(search, R_c, segment.pop(), parameters)]
            break
        turn = find_sharp_turn(search.points[segment])
        if turn is not None:
            centre = search.points[segment[turn]]
            segment = segment[:turn]
            break
        following = next_point(search, segment[-1], parameters)
        if following is None:
            return IntersectionApproach(segment, None)
        segment.append(following)
    return IntersectionApproach(segment, centre)


def find_sharp_turn(points: NDArray[np.float64]) -> int | None:
    """Return the index of a turn by more than `MAX_TURN_RAD` at the third point from the end.

    The direction of the two links before that point is compared with the direction of the two links after it, so that
    no single link decides. Earlier points are not examined: a sequence calls this after every link.

    Args:
        points: (N, 3) linked points, about r_n apart, metres.

    Returns:
        The index N - 3, or None if the sequence does not turn sharply there or has fewer than five points.

    Source:
        Ours.
    """
    if len(points) < 5:
        return None
    before, after = points[-3] - points[-5], points[-1] - points[-3]
    lengths = np.linalg.norm(before) * np.linalg.norm(after)
    return len(points) - 3 if before @ after < np.cos(MAX_TURN_RAD) * lengths else None


def find_restarts(
    search: SearchField, bifurcation_centre: NDArray[np.float64], parameters: ChainParameters
) -> list[Segment]:
    """Return the restart points around an intersection, each with its first link if there is one.

    Points within r_cn of the centre are eliminated. The nearest connectable point within r_cf becomes a restart point.
    Points within r_n of it are eliminated, and it is linked to the nearest connectable point within r_f. This repeats
    until no connectable point lies within r_cf of the centre.

    Args:
        search: Point cloud. Eliminated points become unconnectable.
        bifurcation_centre: (3,) bifurcation centre, metres.
        parameters: Radii r_cn, r_cf, r_n and r_f.

    Returns:
        Segments of one or two points, the nearest to the centre first.

    Source:
        Section III.D.2. Step 1 of the paper says r_cn, but no point within r_cn is connectable. We use r_cf, as in its
        step 2. Eliminating the points within r_n of the linked point is ours.
    """
    search.eliminate(bifurcation_centre, parameters.r_cn)
    restarts = []
    while (restart := search.nearest_connectable(bifurcation_centre, parameters.r_cf)) is not None:
        search.connectable[restart] = False
        linked = next_point(search, restart, parameters)
        if linked is not None:
            # A later restart must not link to the same point.
            search.eliminate(search.points[linked], parameters.r_n)
        restarts.append([restart] if linked is None else [restart, linked])
    return restarts


def _find_largest_ratio(search: SearchField, R_c: NDArray[np.float64], target: int, parameters: ChainParameters) -> int:
    """Return the point at which R_c is largest as the sequence continues from `target`, until R_c decreases."""
    largest = [target]
    while (following := next_point(search, largest[-1], parameters)) is not None:
        if R_c[following] < R_c[largest[-1]]:
            break
        largest = [*largest, following] if R_c[following] == R_c[largest[-1]] else [following]
    return largest[len(largest) // 2]
