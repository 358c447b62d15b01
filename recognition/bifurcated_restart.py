"""Bifurcated restart: leaving out an intersection and starting again on its far sides (section III.D)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.matching import SearchField, Segment, step
from recognition.parameters import ChainParameters


@dataclass(frozen=True, eq=False)
class Approach:
    """A matching sequence up to where it ended or met an intersection."""

    segment: Segment
    """Linked points outside the intersection; may be empty when the sequence started inside."""
    bifurcation_centre: NDArray[np.float64] | None
    """(3,) where R_c was largest; None when the sequence ended in the open."""


def intersection_ratio(
    search: SearchField, in_intersection: NDArray[np.bool_], target: int, parameters: ChainParameters
) -> float:
    """R_c at a target point: the share of intersection points among those within r_f (eq. 7).

    Counted are the points ahead: those that the search has eliminated, behind the target and within r_n of it,
    are out of the process. Were they counted, a line of no width could never reach R_t: on a right-angled cross
    R_c would stay under 1/2. 0 when nothing is ahead.
    """
    centre = search.points[target]
    search.eliminate(centre, parameters.r_n)
    ahead = search.connectable_within(centre, parameters.r_f)
    return float(in_intersection[ahead].mean()) if len(ahead) else 0.0


def approach(
    search: SearchField, in_intersection: NDArray[np.bool_], segment: Segment, parameters: ChainParameters
) -> Approach:
    """Continues `segment` by the matching method until it ends or R_c passes R_t (III.D.1).

    When R_c of a target first exceeds R_t, the previous point is the segment's end. The search walks on while
    R_c does not fall; where it is largest is the bifurcation centre. Over a plateau of equal R_c (the paper
    does not say) it is the plateau's middle point.
    """
    segment = list(segment)
    while (R_c := intersection_ratio(search, in_intersection, segment[-1], parameters)) <= parameters.R_t:
        following = step(search, segment[-1], parameters)
        if following is None:
            return Approach(segment, None)
        segment.append(following)
    highest = [segment.pop()]
    while (following := step(search, highest[-1], parameters)) is not None:
        R_c_following = intersection_ratio(search, in_intersection, following, parameters)
        if R_c_following < R_c:
            break
        highest = [*highest, following] if R_c_following == R_c else [following]
        R_c = R_c_following
    return Approach(segment, search.points[highest[len(highest) // 2]])


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
        linked = step(search, restart, parameters)
        if linked is not None:
            # Taken by this link: a later restart must not link to it as well.
            search.eliminate(search.points[linked], parameters.r_n)
        restarts.append([restart] if linked is None else [restart, linked])
    return restarts
