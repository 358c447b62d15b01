"""Detection of crossings in the projection onto the table. The higher strand is the over strand.

`find_crossings` serves the methods of the paper and measures the heights of the strands on the surface.
`find_fitted_crossings` serves the graph method and uses the heights of the fitted centre lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtr

from recognition.geometry.intersections import Intersection, find_intersections, planar_cross
from recognition.geometry.polyline import arc_length, close_polyline, points_at
from recognition.messages import format_position
from recognition.model.chains import MIN_CERTAIN_CONFIDENCE, Chain, ChainInterpolator, Crossing, StrandPoint
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters
from recognition.strand import Strand

TOP_PERCENTILE = 90.0
"""Percentile of the surface heights near a centre line that gives the top of the strand. Flying pixels are higher."""
HEIGHT_SIGMA_M = 0.0005
"""Standard deviation of the measured height of a strand, metres: depth noise averaged over a patch of size r."""
MAX_FLAT_GAP_SHARE = 0.3
"""A crossing is flat if the height difference of its strands is less than this share of the sum of their radii.

Strands that are pressed together have a share of about 0.6.
"""
MAX_GRAZING_RADII = 6.0
"""Two flat crossings of the same two strands are a grazing contact if they are closer than this along each strand.

The unit is the radius of the thicker strand. At a grazing contact, the strands lie side by side and do not cross.
"""
MAX_GRAZING_RAD = math.radians(30)
"""Maximum angle between the strands at each of these two crossings, radians.

Strands that lie side by side are nearly parallel. In a tight knot, strands cross twice within this length, and their
hidden heights may be too inaccurate to tell them apart.
"""
MAX_UNDECIDED_CONFIDENCE = 0.6
"""Maximum confidence of a crossing if it is flat, or if the views contradict the heights of its strands."""
HIDDEN_RADII = 1.5
"""Distance from the other strand, across it, from which the surface of a strand is measured, in radii r."""
MIN_CROSSING_SINE = 0.3
"""Lower limit of the sine of a crossing angle. It limits the hidden length of nearly parallel strands."""
SAMPLED_RADII = 2.0
"""Length of a strand on each side of a crossing on which its height is measured, in radii r."""
HEIGHT_SAMPLES = 5
"""Number of samples on this length."""
SAMPLE_RADII = 0.5
"""Maximum distance of the surface of a sample from the centre line, seen from above, in radii r."""
MAX_SAMPLE_HEIGHT_RADII = 2.0
"""Maximum height difference between the surface of a sample and the centre line, in radii r. Beyond it lies the surface
of a third strand that passes over or under the sample."""


@dataclass(frozen=True, eq=False)
class _Side:
    """One of the two chains at an intersection."""

    chain: Chain
    """The chain."""
    s_m: float
    """Arc length of the intersection along it, metres."""

    def value(self, values: NDArray[np.float64] | NDArray[np.int64]) -> float:
        """Interpolate the values (N,) at the points of the chain at the intersection."""
        return float(ChainInterpolator(self.chain)(np.array(self.s_m), values.astype(np.float64)))


@dataclass(frozen=True, eq=False)
class CrossingSet:
    """All crossings of a scene, and the findings on uncertain crossings."""

    crossings: tuple[Crossing, ...]
    """Crossings, sorted by strand and then by arc length. The `id` of a crossing is its index in this tuple."""
    findings: tuple[Finding, ...]
    """One finding for each crossing with a confidence below `MIN_CERTAIN_CONFIDENCE`."""


def find_crossings(strands: Sequence[Strand], surface: NDArray[np.float64], parameters: ChainParameters) -> CrossingSet:
    """Return the crossings of the strands. The surface gives the heights of the strands.

    The strand with the higher centre line is over. The height of each strand is measured on the surface on both sides
    of the crossing, where the other strand does not hide it.

    Args:
        strands: Strands of the scene.
        surface: (N, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.

    Returns:
        The crossings, and findings on uncertain crossings. The confidence of a crossing follows from the height
        difference and `HEIGHT_SIGMA_M`.
    """
    crossings: list[Crossing] = []
    findings: list[Finding] = []
    for number, intersection in enumerate(find_intersections(strands)):
        heights = np.array([_measure_height(strands, intersection, which, surface, parameters) for which in (0, 1)])
        gap = float(np.ptp(heights))
        confidence = float(ndtr(gap / (np.sqrt(2) * HEIGHT_SIGMA_M)))
        crossings.append(_make_crossing(intersection, number, heights, confidence))
        if confidence < MIN_CERTAIN_CONFIDENCE:
            findings.append(_uncertain_crossing(crossings[-1], *_reason(gap)))
    return CrossingSet(tuple(crossings), tuple(findings))


def find_fitted_crossings(chains: Sequence[Chain], connections: Sequence[Finding] = ()) -> CrossingSet:
    """Return the crossings of fitted chains. The fitted centre lines give the heights of the chains.

    The chain with the higher centre line is over. The confidence of a crossing follows from the height difference and
    the sigmas of the two chains. It is at most `MAX_UNDECIDED_CONFIDENCE` if the crossing is flat. The same limit
    applies if views saw the under chain at the crossing but no view saw the over chain. Where both chains may be
    connected differently, the crossing is right only if they are connected right.

    Args:
        chains: Fitted chains with `sigma_m` and `views`.
        connections: Doubts about connections of the chains, as `connection_findings` returns them.

    Returns:
        The crossings, and findings on uncertain crossings. Grazing contacts are excluded.
    """
    crossings: list[Crossing] = []
    findings: list[Finding] = []
    for intersection in _remove_grazing_contacts(find_intersections(chains), chains):
        heights = np.array(intersection.heights_m)
        gap = float(np.ptp(heights))
        sides = [_Side(chains[k], s) for k, s in zip(intersection.strands, intersection.s_m, strict=True)]
        sigmas = [side.value(side.chain.sigma_m) for side in sides]
        confidence = float(ndtr(gap / math.hypot(*sigmas)))
        is_contradicted = _is_only_lower_seen(sides, over=int(heights.argmax()))
        if is_contradicted or _is_flat(intersection, chains):
            confidence = min(confidence, MAX_UNDECIDED_CONFIDENCE)
        connected = max(_connection_confidence(side, connections) for side in sides)
        reason = _reason(gap, is_contradicted, is_connection=connected < confidence)
        confidence = min(confidence, connected)
        crossings.append(_make_crossing(intersection, len(crossings), heights, confidence))
        if confidence < MIN_CERTAIN_CONFIDENCE:
            findings.append(_uncertain_crossing(crossings[-1], *reason))
    return CrossingSet(tuple(crossings), tuple(findings))


def _is_only_lower_seen(sides: Sequence[_Side], over: int) -> bool:
    """Return whether views saw the under chain at an intersection, but no view saw the over chain `sides[over]`."""
    views = [side.value(side.chain.views) for side in sides]
    # Between two points of a chain, the number of views is interpolated.
    return views[over] < 0.5 <= views[1 - over]


def _connection_confidence(side: _Side, connections: Sequence[Finding]) -> float:
    """Return the probability that a chain is connected right at an intersection, 0.5 to 1.

    The margin of a connection is the difference of two costs in squared sigmas, twice the logarithm of the odds.
    """
    margins = []
    for found in connections:
        if found.value is None or found.s_range_m is None or found.chains != (side.chain.id,):
            continue
        start, stop = found.s_range_m
        # A part across the first point of a closed chain exceeds the length of the chain.
        if start <= side.s_m <= stop or start <= side.s_m + side.chain.length_m <= stop:
            margins.append(found.value)
    if not margins:
        return 1.0
    return float(expit(min(margins) / 2))


def _make_crossing(
    intersection: Intersection, number: int, heights: NDArray[np.float64], confidence: float
) -> Crossing:
    """Return the crossing at an intersection. `heights` (2,) are the heights of its two strands, metres.

    The sign is +1 if the direction of the over strand turns counter-clockwise to the direction of the under strand,
    seen from above. Otherwise it is -1.
    """
    over = int(heights.argmax())
    under = 1 - over
    turn = float(planar_cross(intersection.directions[over], intersection.directions[under]))
    sign = 1 if turn > 0 else -1
    return Crossing(
        id=number,
        point=np.array([*intersection.xy, float(heights.mean())]),
        over=StrandPoint(intersection.strands[over], intersection.s_m[over]),
        under=StrandPoint(intersection.strands[under], intersection.s_m[under]),
        gap_m=float(np.ptp(heights)),
        angle_rad=_angle_rad(intersection),
        sign=sign,
        confidence=confidence,
    )


def _angle_rad(intersection: Intersection) -> float:
    """Return the angle between the strands at an intersection, seen from above, 0 to pi / 2."""
    a, b = intersection.directions
    return float(np.arctan2(abs(float(planar_cross(a, b))), abs(a @ b)))


def _reason(gap_m: float, is_contradicted: bool = False, is_connection: bool = False) -> tuple[FindingCode, str]:
    """Return the code of the finding on an uncertain crossing, and the reason that its message gives.

    Args:
        gap_m: Difference of the heights of the two strands, metres.
        is_contradicted: Whether the views that saw the strands contradict the heights.
        is_connection: Whether the strands may be connected differently.
    """
    if is_connection:
        return "crossing-undecided", "the strands there may be connected differently"
    if is_contradicted:
        return "upper-strand-unseen", "the upper strand was not seen there"
    return "crossing-undecided", f"the heights of the strands differ by only {gap_m * 1000:.1f} mm"


def _uncertain_crossing(crossing: Crossing, code: FindingCode, reason: str) -> Finding:
    """Return the finding on a crossing with a low confidence, for a reason that `_reason` gives."""
    position = format_position(crossing.point)
    return finding(
        code,
        f"crossing {crossing.id} at {position}: {reason}; which strand is over is not certain",
        chains=sorted({crossing.over.chain, crossing.under.chain}),
        crossing=crossing.id,
        point=crossing.point,
        value=crossing.confidence,
        limit=MIN_CERTAIN_CONFIDENCE,
    )


def _measure_height(
    strands: Sequence[Strand],
    intersection: Intersection,
    which: int,
    surface: NDArray[np.float64],
    parameters: ChainParameters,
) -> float:
    """Return the height of one strand's centre line at an intersection, metres, measured on the surface.

    The surface is sampled along the strand on both sides of the intersection. The samples begin at a distance of
    `HIDDEN_RADII` r / sin(crossing angle), which clears the other strand, and span `SAMPLED_RADII` r. The height is the
    measured top minus r. Without surface, the centre line itself gives the height.

    Args:
        strands: Strands of the scene.
        intersection: Intersection of two strands.
        which: The measured strand, index 0 or 1 into `intersection.strands`.
        surface: (N, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.
    """
    r = parameters.r
    sine = max(abs(float(planar_cross(*intersection.directions))), MIN_CROSSING_SINE)
    from_crossing = r * HIDDEN_RADII / sine + np.linspace(0, SAMPLED_RADII * r, HEIGHT_SAMPLES)
    strand = strands[intersection.strands[which]]
    line = close_polyline(strand.points, strand.closed)
    length = arc_length(line)[-1]
    tops = []
    for sign in (-1, 1):
        s = intersection.s_m[which] + sign * from_crossing
        s = s[(s >= 0) & (s <= length)]
        for point in points_at(line, s):
            is_beside = np.linalg.norm(surface[:, :2] - point[:2], axis=1) < SAMPLE_RADII * r
            is_beside &= np.abs(surface[:, 2] - point[2]) < MAX_SAMPLE_HEIGHT_RADII * r
            if is_beside.any():
                tops.append(float(np.percentile(surface[is_beside, 2], TOP_PERCENTILE)) - r)
    if not tops:
        return intersection.heights_m[which]
    return float(np.mean(tops))


def _remove_grazing_contacts(intersections: Sequence[Intersection], chains: Sequence[Chain]) -> list[Intersection]:
    """Remove the intersections of grazing contacts: pairs of flat intersections that are close together."""
    flat = [k for k, intersection in enumerate(intersections) if _is_flat(intersection, chains)]
    removed: set[int] = set()
    for position, k in enumerate(flat):
        if k in removed:
            continue
        for other in flat[position + 1 :]:
            if other not in removed and _is_same_contact(intersections[k], intersections[other], chains):
                removed |= {k, other}
                break
    return [intersection for k, intersection in enumerate(intersections) if k not in removed]


def _is_flat(intersection: Intersection, chains: Sequence[Chain]) -> bool:
    gap = abs(intersection.heights_m[0] - intersection.heights_m[1])
    return gap < MAX_FLAT_GAP_SHARE * sum(chains[strand].radius_m for strand in intersection.strands)


def _is_same_contact(one: Intersection, other: Intersection, chains: Sequence[Chain]) -> bool:
    """Return whether two intersections have the same nearly parallel strands and are close together along each."""
    if one.strands != other.strands or max(_angle_rad(one), _angle_rad(other)) > MAX_GRAZING_RAD:
        return False
    distances = [
        float(ChainInterpolator(chains[strand]).distance(np.array(s), t))
        for strand, s, t in zip(one.strands, one.s_m, other.s_m, strict=True)
    ]
    return max(distances) < MAX_GRAZING_RADII * max(chains[strand].radius_m for strand in one.strands)
