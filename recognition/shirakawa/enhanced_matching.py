"""Enhanced matching method (section III): matching outside intersections, bifurcated restart at them."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters
from recognition.shirakawa.bifurcated_restart import approach_intersection, find_restarts, intersection_ratios
from recognition.shirakawa.contribution_rate import contribution_rates, intersection_points
from recognition.shirakawa.matching import SearchField, Segment, starting_order


@dataclass(frozen=True, eq=False)
class EnhancedMatching:
    """Segments between intersections, and what they were found by."""

    segments: list[Segment]
    """Indices into the thinned points."""
    bifurcation_centres: NDArray[np.float64]
    """(M, 3)."""
    rho: NDArray[np.float64]
    """(N,) contribution rate of each thinned point (eq. 6)."""
    in_intersection: NDArray[np.bool_]
    """(N,) points that constitute an intersection (III.C)."""
    R_c: NDArray[np.float64]
    """(N,) rate of intersection points around each (eq. 7)."""


def match_enhanced(thinned: NDArray[np.float64], parameters: ChainParameters) -> EnhancedMatching:
    """Segments of the thinned point cloud (N, 3) by the enhanced matching method.

    Sequences run until all points are unconnectable; those that bifurcated restarts ask for come first.
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
    """The segments without the points at their ends that lie within r_cn of a bifurcation centre.

    "Points around an intersection are eliminated from shape recognition" (III.D): also those that a sequence took
    before the intersection was found. A strand that passes through whole is left whole.
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
