"""Strands whose ends lie over one another are one: two strings are never in the same place."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.strand import Strand, join, strand_ends
from recognition.tracing.end_pairing import SHORTEST_RING

OPPOSITE = -0.7
"""Inner product of the directions of two ends that face one another, at most."""
ASIDE_SHARE = 1.0
"""Ends that meet are no farther aside of one another than this share of r; strings side by side are 2 r apart."""
LEAST_OVERLAP = 0.5
"""Length, in radii, by which they reach beyond one another; ends are known to a fifth of a radius or so."""
MOST_OVERLAP = 8.0
"""Both ends are continued by a few radii at most."""
CUT_SHARE = 1.0
"""So much more than half the overlap is taken off each, as a share of r: near an end a line is known worst."""


def merge_overlapping_ends(strands: Sequence[Strand], parameters: ChainParameters) -> list[Strand] | None:
    """The strands, brought to their true ends before, with those joined that reach over one another; None if none do.

    Where noise left a hole in a string's nodes, its two parts are both continued over the surface in between.
    """
    ends = strand_ends(strands, parameters)
    if len(ends) < 2:
        return None
    points, directions = (np.array(values) for values in zip(*((e.point, e.direction) for e in ends), strict=True))
    lengths = np.array([arc_length(strands[end.strand].points)[-1] for end in ends])
    way = points[None] - points[:, None]
    overlap = -np.einsum("jkx,jx->jk", way, directions)
    aside = np.linalg.norm(way + overlap[:, :, None] * directions[:, None], axis=2)
    own = np.array([[a.strand == b.strand for b in ends] for a in ends])
    r = parameters.r
    meet = (overlap > LEAST_OVERLAP * r) & (overlap < MOST_OVERLAP * r) & (aside < ASIDE_SHARE * r)
    meet &= meet.T & (directions @ directions.T < OPPOSITE) & ~(own & (lengths < SHORTEST_RING * r)[:, None])
    j, k = np.nonzero(np.triu(meet, 1))
    couples: list[tuple[int, int]] = []
    for n in np.argsort(aside[j, k], kind="stable"):
        couple = (int(j[n]), int(k[n]))
        if not any(set(couple) & set(other) for other in couples):
            couples.append(couple)
    if not couples:
        return None
    shorter = list(strands)
    for couple in couples:
        for number in couple:
            end = ends[number]
            cut = overlap[couple] / 2 + CUT_SHARE * r
            shorter[end.strand] = _cut(shorter[end.strand], end.at_start, float(cut))
    return join(shorter, strand_ends(shorter, parameters), couples, parameters)


def _cut(strand: Strand, at_start: bool, length: float) -> Strand:
    """The strand without its first or last `length`, but for two points at least."""
    s = arc_length(strand.points)
    from_end = s if at_start else s[-1] - s
    kept: NDArray[np.bool_] = from_end > length
    kept[np.argsort(from_end)[-2:]] = True
    return Strand(strand.points[kept], strand.bridged[kept], strand.closed)
