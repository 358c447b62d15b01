"""Merging of strands whose ends overlap. The strands are parts of one string: two strings cannot share space."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.strand import Strand, join_strands, strand_ends
from recognition.tracing.end_pairing import MIN_RING_RADII

MAX_FACING_COSINE = -0.7
"""Maximum inner product of the outward unit directions of two ends that face each other."""
MAX_LATERAL_RADII = 1.0
"""Maximum distance across the string between overlapping ends, in radii r. Strings side by side are 2 r apart."""
MIN_OVERLAP_RADII = 0.5
"""Minimum length of an overlap, in radii r. The position of an end has an error of about 0.2 r."""
MAX_OVERLAP_RADII = 8.0
"""Maximum length of an overlap, in radii r. Localisation extends each end by a few radii at most."""
EXTRA_CUT_RADII = 1.0
"""Length cut from each end beyond half the overlap, in radii r. A fitted line is least accurate near its end."""


def merge_overlapping_ends(strands: Sequence[Strand], parameters: ChainParameters) -> list[Strand] | None:
    """Join strands whose ends overlap.

    Noise can leave a hole in the nodes of a string, which splits the string into two strands. The localisation of the
    ends then extends each strand over the surface in the hole, so that the strands overlap.

    Args:
        strands: Strands with localised ends.
        parameters: Method parameters; uses the radius r, the length r_f of an end and the spacing r_n of bridges.

    Returns:
        The strands after joining, or None if no ends overlap.

    Source:
        Corresponds to the reconnection of close ends (section III.E.1). The overlap criterion is not in the paper.
    """
    ends = strand_ends(strands, parameters)
    if len(ends) < 2:
        return None
    points = np.array([end.point for end in ends])
    directions = np.array([end.direction for end in ends])
    strand = np.array([end.strand for end in ends])
    lengths = np.array([arc_length(strands[end.strand].points)[-1] for end in ends])
    # Entry [j, k] of the matrices is about end k as seen from end j.
    offset = points[None] - points[:, None]
    overlap = -np.einsum("jkx,jx->jk", offset, directions)
    aside = np.linalg.norm(offset + overlap[:, :, None] * directions[:, None], axis=2)
    same_strand = strand[:, None] == strand
    r = parameters.r
    overlaps = (overlap > MIN_OVERLAP_RADII * r) & (overlap < MAX_OVERLAP_RADII * r) & (aside < MAX_LATERAL_RADII * r)
    overlaps &= overlaps.T & (directions @ directions.T < MAX_FACING_COSINE)
    overlaps &= ~(same_strand & (lengths < MIN_RING_RADII * r)[:, None])
    pairs = _select_pairs(overlaps, aside)
    if not pairs:
        return None
    shortened = list(strands)
    for pair in pairs:
        for number in pair:
            end = ends[number]
            cut = overlap[pair] / 2 + EXTRA_CUT_RADII * r
            shortened[end.strand] = _shorten(shortened[end.strand], end.at_start, float(cut))
    return join_strands(shortened, strand_ends(shortened, parameters), pairs, parameters)


def _select_pairs(overlaps: NDArray[np.bool_], aside: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return pairs of overlapping ends, each end in one pair at most, preferring pairs with a small lateral distance.

    `overlaps` (N, N) is the mask of the possible pairs, and `aside` (N, N) their lateral distance, metres.
    """
    j, k = np.nonzero(np.triu(overlaps, 1))
    pairs: list[tuple[int, int]] = []
    paired: set[int] = set()
    for n in np.argsort(aside[j, k], kind="stable"):
        pair = (int(j[n]), int(k[n]))
        if paired.isdisjoint(pair):
            pairs.append(pair)
            paired.update(pair)
    return pairs


def _shorten(strand: Strand, at_start: bool, length: float) -> Strand:
    """Remove the first (`at_start`) or last `length` metres of a strand. At least two points remain."""
    s = arc_length(strand.points)
    from_end = s if at_start else s[-1] - s
    keep: NDArray[np.bool_] = from_end > length
    keep[np.argsort(from_end)[-2:]] = True
    return Strand(strand.points[keep], strand.bridged[keep], strand.closed)
