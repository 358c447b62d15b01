"""Bifurcated restart: leaving out an intersection and starting again on its far sides (section III.D)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbour_matrix
from recognition.parameters import ChainParameters
from recognition.shirakawa.matching import SearchField, Segment, next_point

SHARP_RAD = np.radians(75)
"""A turn beyond this within two links is not a string's: its bending radius would be about r."""


@dataclass(frozen=True, eq=False)
class Approach:
    """A matching sequence up to where it ended or met an intersection."""

    segment: Segment
    """Linked points outside the intersection; may be empty when the sequence started inside."""
    bifurcation_centre: NDArray[np.float64] | None
    """(3,) where R_c was largest; None when the sequence ended in the open."""


def intersection_ratios(
    points: NDArray[np.float64], in_intersection: NDArray[np.bool_], radius: float
) -> NDArray[np.float64]:
    """(N,) R_c of every point: the share of intersection points among those within `radius` = r_f (eq. 7)."""
    A = neighbour_matrix(points, points, radius)
    return (A @ in_intersection.astype(np.float64)) / np.asarray(A.sum(axis=1))


def approach_intersection(
    search: SearchField, R_c: NDArray[np.float64], segment: Segment, parameters: ChainParameters
) -> Approach:
    """Continues `segment` by the matching method until it ends or meets an intersection (III.D.1).

    That is where R_c of a target exceeds R_t. The search walks on while R_c does not fall; where it is largest is
    the bifurcation centre. Over a plateau of equal R_c (the paper does not say) it is the plateau's middle point.

    Ours: a turn that no string makes (`sharp_turn`) is an intersection too, at which the sequence has gone over
    to the other strand; the turning point is the bifurcation centre.

    The point before R_c first exceeds R_t, or before the turn, is the segment's end.
    """
    segment = list(segment)
    while True:
        if R_c[segment[-1]] > parameters.R_t:
            centre = search.points[_highest(search, R_c, segment.pop(), parameters)]
            break
        turn = sharp_turn(search.points[segment])
        if turn is not None:
            centre = search.points[segment[turn]]
            segment = segment[:turn]
            break
        following = next_point(search, segment[-1], parameters)
        if following is None:
            return Approach(segment, None)
        segment.append(following)
    return Approach(segment, centre)


def sharp_turn(points: NDArray[np.float64]) -> int | None:
    """Index of the last of `points` (N, 3), linked at about r_n, at which the way turns by more than `SHARP_RAD`.

    Compared are the two links before it with the two behind, so that no single link decides. Only the newest
    place that has both is looked at: a sequence is asked about after every link.
    """
    if len(points) < 5:
        return None
    before, behind = points[-3] - points[-5], points[-1] - points[-3]
    lengths = np.linalg.norm(before) * np.linalg.norm(behind)
    return len(points) - 3 if before @ behind < np.cos(SHARP_RAD) * lengths else None


def _highest(search: SearchField, R_c: NDArray[np.float64], target: int, parameters: ChainParameters) -> int:
    """The point at which R_c is largest on the way on from `target`."""
    highest = [target]
    while (following := next_point(search, highest[-1], parameters)) is not None:
        if R_c[following] < R_c[highest[-1]]:
            break
        highest = [*highest, following] if R_c[following] == R_c[highest[-1]] else [following]
    return highest[len(highest) // 2]


def find_restarts(
    search: SearchField, bifurcation_centre: NDArray[np.float64], parameters: ChainParameters
) -> list[Segment]:
    """Restart points around an intersection, each with its first link where there is one (III.D.2).

    Points within r_cn of the centre are eliminated. Then, as long as a connectable point lies within r_cf, the
    nearest becomes a restart point, points within r_n of it are eliminated, and it is linked to the nearest
    connectable one within r_f. (Step 1 of the paper says r_cn, where by then no point is connectable; r_cf, as
    in its step 2, is meant.)
    """
    search.eliminate(bifurcation_centre, parameters.r_cn)
    restarts = []
    while (restart := search.nearest_connectable(bifurcation_centre, parameters.r_cf)) is not None:
        search.connectable[restart] = False
        linked = next_point(search, restart, parameters)
        if linked is not None:
            # Taken by this link: a later restart must not link to it as well.
            search.eliminate(search.points[linked], parameters.r_n)
        restarts.append([restart] if linked is None else [restart, linked])
    return restarts
