"""Crossings of strands as seen from above, and which strand is over, by measured height."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from recognition.geometry.intersections import Intersection, find_intersections
from recognition.geometry.polyline import arc_length, close_polyline, points_at
from recognition.messages import format_position
from recognition.model.model import Crossing, StrandPoint
from recognition.parameters import ChainParameters
from recognition.strand import Strand

TOP_PERCENTILE = 90.0
"""Of the points beside a strand's middle, the height taken as its top: above most noise, below flying pixels."""
CERTAIN = 0.9
"""Least confidence of a crossing that is not told as ambiguous."""
HEIGHT_SIGMA_M = 0.0005
"""One sigma of a strand's measured height: depth noise averaged over a patch of r."""


def find_crossings(
    strands: Sequence[Strand], surface: NDArray[np.float64], parameters: ChainParameters
) -> tuple[list[Crossing], list[str]]:
    """All crossings of the strands, and in words which of them could not be decided.

    Which strand is over is measured on `surface` (N, 3): the higher top beside the crossing. The over strand is
    seen right at the crossing, the under one as near to it as the over one lets it be seen.
    """
    crossings, ambiguities = [], []
    for number, meeting in enumerate(find_intersections(strands)):
        heights = np.array([_height(strands, meeting, side, surface, parameters) for side in (0, 1)])
        gap = float(np.ptp(heights))
        confidence = float(ndtr(gap / (np.sqrt(2) * HEIGHT_SIGMA_M)))
        crossings.append(crossing_of(meeting, number, heights, confidence))
        if confidence < CERTAIN:
            ambiguities.append(uncertain_crossing_message(crossings[-1], height_difference_message(gap)))
    return crossings, ambiguities


def crossing_of(meeting: Intersection, number: int, heights: NDArray[np.float64], confidence: float) -> Crossing:
    """The crossing where two strands meet at the `heights` (2,), the higher one over the other.

    Its sign is that of the turn from the over strand's direction to the under one's, seen from above.
    """
    over = int(heights.argmax())
    a, b = meeting.directions[over], meeting.directions[1 - over]
    turn = float(a[0] * b[1] - a[1] * b[0])
    upper, lower = (StrandPoint(meeting.strands[k], meeting.s_m[k]) for k in (over, 1 - over))
    return Crossing(
        id=number,
        point=np.array([*meeting.xy, float(heights.mean())]),
        over=upper,
        under=lower,
        gap_m=float(np.ptp(heights)),
        angle_rad=float(np.arctan2(abs(turn), abs(a @ b))),
        sign=1 if turn > 0 else -1,
        confidence=confidence,
    )


def uncertain_crossing_message(crossing: Crossing, why: str) -> str:
    """In words, that which of the strands is over is not certain."""
    return f"crossing {crossing.id} at {format_position(crossing.point)}: {why}; which is over is not certain"


def height_difference_message(gap_m: float) -> str:
    """In words, why a crossing is not certain where the strands are too near in height."""
    return f"the strands' heights differ by {gap_m * 1000:.1f} mm only"


def _height(
    strands: Sequence[Strand],
    meeting: Intersection,
    side: int,
    surface: NDArray[np.float64],
    parameters: ChainParameters,
) -> float:
    """z of a strand's centre line at the crossing, from the tops seen on both sides of the other strand.

    Its own ridge is looked at, within r / 2 of its line, at distances at which the other strand (r wide on its
    side, and r / 2 to clear its flank) is out of the way, up to 2 r farther. Where nothing is seen there, the
    chain's own height counts.
    """
    own, other = meeting.directions[side], meeting.directions[1 - side]
    sine = max(abs(float(own[0] * other[1] - own[1] * other[0])), 0.3)
    hidden = parameters.r * 1.5 / sine
    strand = strands[meeting.strands[side]]
    line = close_polyline(strand.points, strand.closed)
    length = arc_length(line)[-1]
    tops = []
    for sign in (-1, 1):
        offsets = meeting.s_m[side] + sign * (hidden + np.linspace(0, 2 * parameters.r, 5))
        offsets = offsets[(offsets >= 0) & (offsets <= length)]
        places = points_at(line, offsets)
        for place in places:
            beside = np.linalg.norm(surface[:, :2] - place[:2], axis=1) < parameters.r / 2
            # Not the tops of a third strand that passes here.
            beside &= np.abs(surface[:, 2] - place[2]) < 2 * parameters.r
            if beside.any():
                tops.append(float(np.percentile(surface[beside, 2], TOP_PERCENTILE)) - parameters.r)
    return float(np.mean(tops)) if tops else meeting.heights_m[side]
