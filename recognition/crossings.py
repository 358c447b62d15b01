"""Crossings of strands as seen from above, and which strand is over, by measured height."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from recognition.joining import Strand
from recognition.model import Crossing, StrandPoint
from recognition.parameters import ChainParameters
from recognition.polyline import arc_length, closed_up, points_at
from recognition.wording import in_mm

TOP_PERCENTILE = 90.0
"""Of the points beside a strand's middle, the height taken as its top: above most noise, below flying pixels."""
PARALLEL = 1e-6
"""Sine of the angle under which links count as parallel: where such meet is rounding."""
ROUNDING = 1e-9
"""Share of a link within which rounding may put a crossing beyond its end."""
SAME_PLACE_M = 1e-6
"""Crossings closer than this along both strands are one, found in two links."""
CERTAIN = 0.9
"""Least confidence of a crossing that is not told as ambiguous."""
HEIGHT_SIGMA_M = 0.0005
"""One sigma of a strand's measured height: depth noise averaged over a patch of r."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """Two strands crossing in the projection onto the table."""

    strands: tuple[int, int]
    """Indices; the same twice for a strand that crosses itself."""
    s_m: tuple[float, float]
    """Arc length along each."""
    heights_m: tuple[float, float]
    """z of each polyline there."""
    directions: tuple[NDArray[np.float64], NDArray[np.float64]]
    """(2,) unit vectors of each in the table plane."""
    xy: NDArray[np.float64]
    """(2,)."""


def find_crossings(
    strands: Sequence[Strand], surface: NDArray[np.float64], parameters: ChainParameters
) -> tuple[list[Crossing], list[str]]:
    """All crossings of the strands, and in words which of them could not be decided.

    Which strand is over is measured on `surface` (N, 3): the higher top beside the crossing. The over strand is
    seen right at the crossing, the under one as near to it as the over one lets it be seen.
    """
    crossings, ambiguities = [], []
    for number, meeting in enumerate(meetings(strands)):
        heights = np.array([_height(strands, meeting, side, surface, parameters) for side in (0, 1)])
        gap = float(np.ptp(heights))
        confidence = float(ndtr(gap / (np.sqrt(2) * HEIGHT_SIGMA_M)))
        crossings.append(crossing_of(meeting, number, heights, confidence))
        if confidence < CERTAIN:
            ambiguities.append(not_certain(crossings[-1], heights_differ_by(gap)))
    return crossings, ambiguities


def crossing_of(meeting: Meeting, number: int, heights: NDArray[np.float64], confidence: float) -> Crossing:
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


def not_certain(crossing: Crossing, why: str) -> str:
    """In words, that which of the strands is over is not certain."""
    return f"crossing {crossing.id} at {in_mm(crossing.point)}: {why}; which is over is not certain"


def heights_differ_by(gap_m: float) -> str:
    """In words, why a crossing is not certain where the strands are too near in height."""
    return f"the strands' heights differ by {gap_m * 1000:.1f} mm only"


class Line(Protocol):
    """What can cross: strands and chains."""

    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def closed(self) -> bool: ...


def meetings(strands: Sequence[Line]) -> list[Meeting]:
    """Where the strands cross one another or themselves, as seen from above."""
    if not strands:
        return []
    low, high = (np.array([end(strand.points[:, :2], axis=0) for strand in strands]) for end in (np.min, np.max))
    margin = ROUNDING * (high - low).max(initial=0.0)
    # Most of many strands are nowhere near one another.
    near = ((low[:, None] <= high[None] + margin) & (low[None] <= high[:, None] + margin)).all(axis=2)
    found = []
    for i, j in zip(*np.nonzero(np.triu(near)), strict=True):
        found += _intersections(strands, int(i), int(j))
    return found


def _intersections(strands: Sequence[Line], i: int, j: int) -> list[Meeting]:
    """Where strand i crosses strand j in the xy plane: every pair of links at once."""
    P, Q = (closed_up(strands[k].points, strands[k].closed) for k in (i, j))
    s, t = arc_length(P), arc_length(Q)
    p, q = P[:-1, None, :2], Q[None, :-1, :2]
    u, v = np.diff(P[:, :2], axis=0)[:, None], np.diff(Q[:, :2], axis=0)[None]
    determinant = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    w = q - p
    parallel = np.abs(determinant) <= PARALLEL * np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / determinant
        b = (w[..., 0] * u[..., 1] - w[..., 1] * u[..., 0]) / determinant
        # A little beyond the links' ends, so that no crossing in a point of the chain falls between two of them.
        hit = ~parallel & (np.abs(a - 0.5) <= 0.5 + ROUNDING) & (np.abs(b - 0.5) <= 0.5 + ROUNDING)
    if i == j:
        m, n = np.indices(hit.shape)
        # Neighbouring links share a point and do not cross; in a closed strand also the last and the first.
        hit &= (n > m + 1) & ~(strands[i].closed & (m == 0) & (n == hit.shape[1] - 1))
    meetings: list[Meeting] = []
    for m, n in zip(*np.nonzero(hit), strict=True):
        places = (float(s[m] + a[m, n] * (s[m + 1] - s[m])), float(t[n] + b[m, n] * (t[n + 1] - t[n])))
        if any(np.allclose(places, known.s_m, rtol=0, atol=SAME_PLACE_M) for known in meetings):
            continue
        directions = tuple(d / np.linalg.norm(d) for d in (u[m, 0], v[0, n]))
        meetings.append(
            Meeting(
                strands=(i, j),
                s_m=places,
                heights_m=(
                    float(P[m, 2] + a[m, n] * (P[m + 1, 2] - P[m, 2])),
                    float(Q[n, 2] + b[m, n] * (Q[n + 1, 2] - Q[n, 2])),
                ),
                directions=(directions[0], directions[1]),
                xy=P[m, :2] + a[m, n] * u[m, 0],
            )
        )
    return meetings


def _height(
    strands: Sequence[Strand],
    meeting: Meeting,
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
    line = closed_up(strand.points, strand.closed)
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
