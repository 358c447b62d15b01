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
    crossings, findings = [], []
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
    crossings, findings = [], []
    for intersection in _remove_grazing_contacts(find_intersections(chains), chains):
        heights = np.array(intersection.heights_m)
        over = int(heights.argmax())
        gap = float(np.ptp(heights))
        sigma = math.hypot(
            *(_value_at(chains[intersection.strands[k]], intersection.s_m[k], "sigma_m") for k in (0, 1))
        )
        confidence = float(ndtr(gap / sigma))
        views_over, views_under = (
            _value_at(chains[intersection.strands[k]], intersection.s_m[k], "views") for k in (over, 1 - over)
        )
        contradicted = views_over < 0.5 <= views_under
        if contradicted or _is_flat(intersection, chains):
            confidence = min(confidence, MAX_UNDECIDED_CONFIDENCE)
        connected = max(
            _connection_confidence(chains[chain], s, connections)
            for chain, s in zip(intersection.strands, intersection.s_m, strict=True)
        )
        reason = _reason(gap, contradicted, is_connection=connected < confidence)
        confidence = min(confidence, connected)
        crossings.append(_make_crossing(intersection, len(crossings), heights, confidence))
        if confidence < MIN_CERTAIN_CONFIDENCE:
            findings.append(_uncertain_crossing(crossings[-1], *reason))
    return CrossingSet(tuple(crossings), tuple(findings))


def _connection_confidence(chain: Chain, s_m: float, connections: Sequence[Finding]) -> float:
    """Return the probability that the chain is connected right at the arc length `s_m`, metres, 0.5 to 1.

    The margin of a connection is the difference of two costs in squared sigmas, twice the logarithm of the odds.
    """
    margins = [
        found.value
        for found in connections
        if found.value is not None
        and found.s_range_m is not None
        and found.chains == (chain.id,)
        and any(found.s_range_m[0] <= s <= found.s_range_m[1] for s in (s_m, s_m + chain.length_m))
    ]
    return float(expit(min(margins) / 2)) if margins else 1.0


def _make_crossing(
    intersection: Intersection, number: int, heights: NDArray[np.float64], confidence: float
) -> Crossing:
    """Return the crossing at an intersection. `heights` (2,) are the heights of its two strands, metres.

    The sign is +1 if the direction of the over strand turns counter-clockwise to the direction of the under strand,
    seen from above. Otherwise it is -1.
    """
    over = int(heights.argmax())
    turn = float(planar_cross(intersection.directions[over], intersection.directions[1 - over]))
    upper, lower = (StrandPoint(intersection.strands[k], intersection.s_m[k]) for k in (over, 1 - over))
    return Crossing(
        id=number,
        point=np.array([*intersection.xy, float(heights.mean())]),
        over=upper,
        under=lower,
        gap_m=float(np.ptp(heights)),
        angle_rad=_angle_rad(intersection),
        sign=1 if turn > 0 else -1,
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
    1.5 r / sin(crossing angle), which clears the other strand, and span 2 r. Each sample uses the surface points within
    r / 2 of the centre line, seen from above. The height is the measured top minus r. Without surface, the centre line
    itself gives the height.

    Args:
        strands: Strands of the scene.
        intersection: Intersection of two strands.
        which: The measured strand, index 0 or 1 into `intersection.strands`.
        surface: (N, 3) registered surface points, metres, base frame.
        parameters: Method parameters; uses the radius r.
    """
    own, other = intersection.directions[which], intersection.directions[1 - which]
    sine = max(abs(float(planar_cross(own, other))), 0.3)
    hidden = parameters.r * 1.5 / sine
    strand = strands[intersection.strands[which]]
    line = close_polyline(strand.points, strand.closed)
    length = arc_length(line)[-1]
    tops = []
    for sign in (-1, 1):
        offsets = intersection.s_m[which] + sign * (hidden + np.linspace(0, 2 * parameters.r, 5))
        offsets = offsets[(offsets >= 0) & (offsets <= length)]
        for point in points_at(line, offsets):
            beside = np.linalg.norm(surface[:, :2] - point[:2], axis=1) < parameters.r / 2
            # Exclude the surface of a third strand that passes over or under this point.
            beside &= np.abs(surface[:, 2] - point[2]) < 2 * parameters.r
            if beside.any():
                tops.append(float(np.percentile(surface[beside, 2], TOP_PERCENTILE)) - parameters.r)
    return float(np.mean(tops)) if tops else intersection.heights_m[which]


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
    if one.strands != other.strands or max(map(_angle_rad, (one, other))) > MAX_GRAZING_RAD:
        return False
    distances = [
        ChainInterpolator(chains[strand]).distance(np.array(s), t)
        for strand, s, t in zip(one.strands, one.s_m, other.s_m, strict=True)
    ]
    return max(map(float, distances)) < MAX_GRAZING_RADII * max(chains[strand].radius_m for strand in one.strands)


def _value_at(chain: Chain, s_m: float, field: str) -> float:
    """Interpolate the point values in `field` of a chain (such as "sigma_m") at the arc length `s_m`, metres."""
    values = np.asarray(getattr(chain, field), dtype=np.float64)
    return float(ChainInterpolator(chain)(np.array(s_m), values))
