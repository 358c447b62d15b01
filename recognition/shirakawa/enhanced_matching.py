"""Enhanced matching method (section III): thinning, distinction of intersections, and matching outside them."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import neighbourhood_means
from recognition.parameters import ChainParameters
from recognition.shirakawa.bifurcated_restart import approach_intersection, find_restarts, intersection_ratios
from recognition.shirakawa.contribution_rate import contribution_rates, intersection_points
from recognition.shirakawa.matching import SearchField, Segment, starting_order


@dataclass(frozen=True, eq=False)
class EnhancedMatching:
    """Segments between intersections, and the measures that led to them."""

    segments: list[Segment]
    """Linked points, as indices into the thinned points."""
    bifurcation_centres: NDArray[np.float64]
    """(M, 3) bifurcation centres, metres (III.D)."""
    rho: NDArray[np.float64]
    """(N,) contribution rate of each thinned point (eq. 6)."""
    in_intersection: NDArray[np.bool_]
    """(N,) whether a thinned point constitutes an intersection (III.C)."""
    R_c: NDArray[np.float64]
    """(N,) share of intersection points around each thinned point (eq. 7)."""


def thin(points: NDArray[np.float64], parameters: ChainParameters) -> NDArray[np.float64]:
    """Move each point to the mean of its neighbours within r_c, itself included.

    Args:
        points: (N, 3) points of the centre line, metres.
        parameters: Radius r_c.

    Returns:
        (N, 3) thinned points, metres.

    Source:
        Section III.B, eq. (3).
    """
    return neighbourhood_means(points, points, points, parameters.r_c)


def match_enhanced(thinned: NDArray[np.float64], parameters: ChainParameters) -> EnhancedMatching:
    """Link the thinned points to segments by the enhanced matching method.

    Sequences run until all points are unconnectable. Sequences from restart points come first.

    Args:
        thinned: (N, 3) thinned points, metres.
        parameters: Radii and thresholds of Table I.

    Returns:
        The segments, the bifurcation centres, and the measures of each point.

    Source:
        Sections III.C and III.D. The starting points are ours (`starting_order`).
    """
    rho = contribution_rates(thinned, parameters.r_s)
    in_intersection = intersection_points(thinned, rho, parameters)
    R_c = intersection_ratios(thinned, in_intersection, parameters.r_f)
    search = SearchField(thinned)
    starts = iter(starting_order(search, parameters.r_f))
    pending: deque[Segment] = deque()
    segments: list[Segment] = []
    centres: list[NDArray[np.float64]] = []
    while True:
        if not pending:
            start = next((int(i) for i in starts if search.connectable[i]), None)
            if start is None:
                break
            pending.append([start])
        found = approach_intersection(search, R_c, pending.popleft(), parameters)
        if found.segment:
            segments.append(found.segment)
        if found.bifurcation_centre is not None:
            centres.append(found.bifurcation_centre)
            pending.extend(find_restarts(search, found.bifurcation_centre, parameters))
    bifurcation_centres = np.array(centres).reshape(-1, 3)
    segments = trim_at_intersections(thinned, segments, bifurcation_centres, parameters)
    return EnhancedMatching(segments, bifurcation_centres, rho, in_intersection, R_c)


def trim_at_intersections(
    points: NDArray[np.float64],
    segments: list[Segment],
    bifurcation_centres: NDArray[np.float64],
    parameters: ChainParameters,
) -> list[Segment]:
    """Remove the points at the ends of segments that are closer than r_cn to a bifurcation centre.

    A segment that passes an intersection and leaves it again keeps its points there.

    Args:
        points: (N, 3) thinned points, metres.
        segments: Linked points, as indices into `points`.
        bifurcation_centres: (M, 3) bifurcation centres, metres.
        parameters: Radius r_cn.

    Returns:
        The segments that keep at least one point.

    Source:
        Section III.D: "points around an intersection are eliminated from shape recognition". Ours: this includes the
        points that a sequence linked before the intersection was found.
    """
    if len(bifurcation_centres) == 0:
        return segments
    distance, _ = KDTree(bifurcation_centres).query(points)
    kept = []
    for segment in segments:
        clear = np.flatnonzero(distance[segment] >= parameters.r_cn)
        if len(clear):
            kept.append(segment[clear[0] : clear[-1] + 1])
    return kept
