"""Bifurcated restart (section III.D): the matching stops at an intersection and starts again beyond it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbour_matrix
from recognition.parameters import ChainParameters
from recognition.shirakawa.matching import SearchField, Segment, next_point

MAX_TURN_RAD = np.radians(75)
"""Maximum turn of a string over two links, radians. A sharper turn would mean a bend radius of about r."""


@dataclass(frozen=True, eq=False)
class IntersectionApproach:
    """Result of a matching sequence that ran to its end or to an intersection.

    Source:
        Section III.D.1.
    """

    segment: Segment
    """Indices of the linked points outside the intersection. Empty if the sequence started inside an intersection."""
    bifurcation_centre: NDArray[np.float64] | None
    """(3,) bifurcation centre, metres. None if the sequence ended without an intersection."""


def intersection_ratios(
    points: NDArray[np.float64], in_intersection: NDArray[np.bool_], radius: float
) -> NDArray[np.float64]:
    """Return R_c of each point: the ratio of intersection points among the neighbours of the point.

    Args:
        points: (N, 3) points, metres.
        in_intersection: Mask (N,), True for the points of an intersection.
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
    """Continue a segment by the matching method to its end or to an intersection.

    An intersection begins at the first point whose R_c exceeds R_t. The segment ends before this point. The sequence
    then continues until R_c decreases. The point with the largest R_c is the bifurcation centre.

    Args:
        search: Point cloud. Points that the sequence passes become unconnectable.
        R_c: (N,) intersection ratio of each point.
        segment: Indices of the points linked so far, at least one. The list is not changed.
        parameters: Method parameters; uses the threshold R_t and the radii r_n and r_f.

    Returns:
        The continued segment, and the bifurcation centre if an intersection was reached.

    Source:
        Section III.D.1. Two rules are not in the paper. If consecutive points share the largest R_c, the middle point
        is the bifurcation centre. A sharp turn (`find_sharp_turn`) also counts as an intersection, because the sequence
        changed to another strand there. The turning point is then the bifurcation centre, and the segment ends before
        this point.
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
    """Return the index of the third last point if the sequence turns by more than `MAX_TURN_RAD` there.

    The turn is measured between two directions: over the two links before the point, and over the two links after the
    point. A single link is too noisy. Earlier points are not examined, because this function is called after every
    link.

    Args:
        points: (N, 3) linked points, about r_n apart, metres.

    Returns:
        The index N - 3. None if the sequence does not turn sharply there, or has fewer than five points.
    """
    if len(points) < 5:
        return None
    before = points[-3] - points[-5]
    after = points[-1] - points[-3]
    lengths = np.linalg.norm(before) * np.linalg.norm(after)
    if before @ after < np.cos(MAX_TURN_RAD) * lengths:
        return len(points) - 3
    return None


def find_restarts(
    search: SearchField, bifurcation_centre: NDArray[np.float64], parameters: ChainParameters
) -> list[Segment]:
    """Return the restart points around an intersection, each with its first linked point if there is one.

    Points within r_cn of the centre are eliminated. The nearest connectable point within r_cf of the centre becomes a
    restart point. Points within r_n of the restart point are eliminated. The restart point is then linked to its
    nearest connectable point within r_f. These steps repeat until no connectable point lies within r_cf of the centre.

    Args:
        search: Point cloud. Eliminated points become unconnectable.
        bifurcation_centre: (3,) bifurcation centre, metres.
        parameters: Method parameters; uses the radii r_cn, r_cf, r_n and r_f.

    Returns:
        Segments of one or two point indices. The restart point comes first. Segments are sorted by the distance of the
        restart point from the centre.

    Source:
        Section III.D.2. Step 1 of the paper searches within r_cn, but no point there is connectable. Here r_cf is used,
        as in step 2 of the paper. The paper does not eliminate the points within r_n of the linked point.
    """
    search.eliminate(bifurcation_centre, parameters.r_cn)
    restarts = []
    while (restart := search.nearest_connectable(bifurcation_centre, parameters.r_cf)) is not None:
        search.connectable[restart] = False
        segment = [restart]
        linked = next_point(search, restart, parameters)
        if linked is not None:
            segment.append(linked)
            # A later restart must not link to the same point.
            search.eliminate(search.points[linked], parameters.r_n)
        restarts.append(segment)
    return restarts


def _find_largest_ratio(search: SearchField, R_c: NDArray[np.float64], target: int, parameters: ChainParameters) -> int:
    """Continue the sequence from `target` until R_c decreases, and return the index of the point with the largest R_c.

    If consecutive points share the largest R_c, return the middle point.
    """
    # Consecutive points with the largest R_c so far.
    largest = [target]
    while (following := next_point(search, largest[-1], parameters)) is not None:
        if R_c[following] < R_c[largest[-1]]:
            break
        if R_c[following] > R_c[largest[-1]]:
            largest.clear()
        largest.append(following)
    return largest[len(largest) // 2]
