"""Enhanced matching method (section III): thinning, detection of intersections, and matching between intersections."""

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
    """Result of the enhanced matching method for N thinned points."""

    segments: list[Segment]
    """Segments between the intersections, as indices into the thinned points."""
    bifurcation_centres: NDArray[np.float64]
    """(M, 3) bifurcation centres, metres (III.D)."""
    rho: NDArray[np.float64]
    """(N,) contribution rate of each thinned point (eq. 6)."""
    in_intersection: NDArray[np.bool_]
    """(N,) mask, True for the points of an intersection (III.C)."""
    R_c: NDArray[np.float64]
    """(N,) ratio of intersection points among the neighbours of each thinned point (eq. 7)."""


def thin(points: NDArray[np.float64], parameters: ChainParameters) -> NDArray[np.float64]:
    """Move each point to the mean of the points within r_c, including the point itself.

    Args:
        points: (N, 3) points of the centre line, metres.
        parameters: Method parameters; uses the radius r_c.

    Returns:
        (N, 3) thinned points, metres.

    Source:
        Section III.B, eq. (3).
    """
    return neighbourhood_means(points, points, points, parameters.r_c)


def match_enhanced(thinned: NDArray[np.float64], parameters: ChainParameters) -> EnhancedMatching:
    """Link the thinned points to segments by the enhanced matching method.

    New sequences start until no connectable point is left. Restart points come before all other starting points.

    Args:
        thinned: (N, 3) thinned points, metres.
        parameters: Method parameters; uses r_s, rho_t, R_t, r_n, r_f, r_cn and r_cf.

    Returns:
        The segments, the bifurcation centres, and rho and R_c of each point.

    Source:
        Sections III.C and III.D. The order of the starting points is not in the paper (see `starting_order`).
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
    """Remove the points at the ends of each segment that lie within r_cn of a bifurcation centre.

    A segment that passes through an intersection keeps its points inside the intersection.

    Args:
        points: (N, 3) thinned points, metres.
        segments: Linked points, as indices into `points`.
        bifurcation_centres: (M, 3) bifurcation centres, metres.
        parameters: Method parameters; uses the radius r_cn.

    Returns:
        The shortened segments, without segments that have no point left.

    Source:
        Section III.D: "points around an intersection are eliminated from shape recognition". Here this includes points
        that were linked before the intersection was found. The paper does not mention these points.
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
