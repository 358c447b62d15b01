"""Crossings of fitted chains: which strand is over follows from the heights of the two centre lines."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from recognition.crossings import CERTAIN, crossing_of, heights_differ_by, not_certain
from recognition.meetings import Meeting, meetings
from recognition.model import Chain, Crossing

LEAST_GAP = 0.6
"""Strands that cross are at least this share of both radii apart in height, also where they are pressed together."""
GRAZING = 6.0
"""Two crossings of the same strands nearer than this, in radii, along both, without a gap in height, are one grazing
contact: side by side, not across."""


def fitted_crossings(chains: Sequence[Chain]) -> tuple[list[Crossing], list[str]]:
    """All crossings of the chains, and in words which of them could not be decided.

    The higher centre line is over. The confidence weighs the gap against the heights' sigmas, and it is that of a
    guess where the chain that is under was seen there and the one that is over was not.
    """
    crossings, ambiguities = [], []
    for meeting in _across(meetings(chains), chains):
        heights = np.array(meeting.heights_m)
        over = int(heights.argmax())
        gap = float(np.ptp(heights))
        sigma = math.hypot(*(_at(chains[meeting.strands[k]], meeting.s_m[k], "sigma_m") for k in (0, 1)))
        confidence = float(ndtr(gap / sigma))
        seen = [_at(chains[meeting.strands[k]], meeting.s_m[k], "views") for k in (over, 1 - over)]
        contradicted = seen[0] < 0.5 <= seen[1]
        radii = sum(chains[k].radius_m for k in meeting.strands)
        if contradicted or gap < 0.5 * LEAST_GAP * radii:
            confidence = min(confidence, 0.6)
        crossings.append(crossing_of(meeting, len(crossings), heights, confidence))
        if confidence < CERTAIN:
            why = "the upper one was not seen there" if contradicted else heights_differ_by(gap)
            ambiguities.append(not_certain(crossings[-1], why))
    return crossings, ambiguities


def _across(found: Sequence[Meeting], chains: Sequence[Chain]) -> list[Meeting]:
    """The meetings without grazing contacts: couples near one another at which the heights hardly differ."""
    flat = [
        k
        for k, meeting in enumerate(found)
        if abs(meeting.heights_m[0] - meeting.heights_m[1])
        < LEAST_GAP * sum(chains[strand].radius_m for strand in meeting.strands)
    ]
    dropped: set[int] = set()
    for place, k in enumerate(flat):
        if k in dropped:
            continue
        reach = GRAZING * chains[found[k].strands[0]].radius_m
        for other in flat[place + 1 :]:
            near = np.abs(np.subtract(found[k].s_m, found[other].s_m)) < reach
            if other not in dropped and found[k].strands == found[other].strands and near.all():
                dropped |= {k, other}
                break
    return [meeting for k, meeting in enumerate(found) if k not in dropped]


def _at(chain: Chain, s_m: float, field: str) -> float:
    """A chain's value, given for each of its points, at arc length `s_m`."""
    return float(np.interp(s_m, chain.arc_length_m, getattr(chain, field)))
