"""Crossings of fitted chains: which strand is over follows from the heights of the two centre lines."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from recognition.assembly.crossings import CERTAIN, crossing_of, height_difference_message, uncertain_crossing_message
from recognition.geometry.intersections import Intersection, find_intersections
from recognition.model.interpolation import ChainInterpolator
from recognition.model.model import Chain, Crossing

FLAT = 0.3
"""Strands whose heights differ by less than this share of both radii are not on one another: pressed together they
are 0.6 apart, and what is measured scatters about that."""
GRAZING = 6.0
"""Two flat meetings of the same strands nearer than this, in radii, along both are one grazing contact: side by side,
not across."""
UNDECIDED = 0.6
"""Most confidence of a crossing whose strands are flat, or of which the view contradicts the heights."""


def find_fitted_crossings(chains: Sequence[Chain]) -> tuple[list[Crossing], list[str]]:
    """All crossings of the chains, and in words which of them could not be decided.

    The higher centre line is over. The confidence weighs the gap against the heights' sigmas, and it is that of a
    guess where the chain that is under was seen there and the one that is over was not.
    """
    crossings, ambiguities = [], []
    for meeting in _across(find_intersections(chains), chains):
        heights = np.array(meeting.heights_m)
        over = int(heights.argmax())
        gap = float(np.ptp(heights))
        sigma = math.hypot(*(_at(chains[meeting.strands[k]], meeting.s_m[k], "sigma_m") for k in (0, 1)))
        confidence = float(ndtr(gap / sigma))
        seen = [_at(chains[meeting.strands[k]], meeting.s_m[k], "views") for k in (over, 1 - over)]
        contradicted = seen[0] < 0.5 <= seen[1]
        if contradicted or _flat(meeting, chains):
            confidence = min(confidence, UNDECIDED)
        crossings.append(crossing_of(meeting, len(crossings), heights, confidence))
        if confidence < CERTAIN:
            why = "the upper one was not seen there" if contradicted else height_difference_message(gap)
            ambiguities.append(uncertain_crossing_message(crossings[-1], why))
    return crossings, ambiguities


def _across(found: Sequence[Intersection], chains: Sequence[Chain]) -> list[Intersection]:
    """The meetings without grazing contacts: couples near one another at which the heights hardly differ."""
    flat = [k for k, meeting in enumerate(found) if _flat(meeting, chains)]
    dropped: set[int] = set()
    for place, k in enumerate(flat):
        if k in dropped:
            continue
        for other in flat[place + 1 :]:
            if other not in dropped and _one_contact(found[k], found[other], chains):
                dropped |= {k, other}
                break
    return [meeting for k, meeting in enumerate(found) if k not in dropped]


def _flat(meeting: Intersection, chains: Sequence[Chain]) -> bool:
    gap = abs(meeting.heights_m[0] - meeting.heights_m[1])
    return gap < FLAT * sum(chains[strand].radius_m for strand in meeting.strands)


def _one_contact(one: Intersection, other: Intersection, chains: Sequence[Chain]) -> bool:
    if one.strands != other.strands:
        return False
    ways = [
        ChainInterpolator(chains[strand]).apart(np.array(s), t)
        for strand, s, t in zip(one.strands, one.s_m, other.s_m, strict=True)
    ]
    return max(map(float, ways)) < GRAZING * max(chains[strand].radius_m for strand in one.strands)


def _at(chain: Chain, s_m: float, field: str) -> float:
    """A chain's value, given for each of its points, at arc length `s_m`."""
    values = np.asarray(getattr(chain, field), dtype=np.float64)
    return float(ChainInterpolator(chain)(np.array(s_m), values))
