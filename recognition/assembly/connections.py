"""Findings on connections that may be wrong: pairs of fragment ends that were joined with a small margin."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.tracing.end_pairing import MIN_CERTAIN_MARGIN, AmbiguousPair

MARGIN_RADII = 2.0
"""Distance beyond the two ends of a pair up to which a chain is concerned, in radii of the chain."""


def connection_findings(pairs: Iterable[AmbiguousPair], chains: Sequence[Chain]) -> list[Finding]:
    """Return the doubts about pairs of ends that may be wrong.

    Args:
        pairs: Ambiguous pairs of fragment ends.
        chains: Chains of the model.

    Returns:
        One doubt for each part of a chain that passes the gap of a pair. A pair whose strand is in no chain gives none.
    """
    findings = []
    for pair in pairs:
        middle = pair.points.mean(axis=0)
        half_gap = float(np.linalg.norm(pair.points[1] - pair.points[0])) / 2
        for chain in chains:
            for start, stop in _parts_near(chain, middle, half_gap + MARGIN_RADII * chain.radius_m):
                message = (
                    f"chain {chain.id}, {start * 1000:.0f} to {stop * 1000:.0f} mm along it: the strands at "
                    f"{format_position(middle)} may be connected differently; which ends belong together is not certain"
                )
                findings.append(
                    finding(
                        "connection-uncertain",
                        message,
                        chains=(chain.id,),
                        s_range_m=(start, stop),
                        point=middle,
                        value=pair.margin,
                        limit=MIN_CERTAIN_MARGIN,
                    )
                )
    return findings


def _parts_near(chain: Chain, point: NDArray[np.float64], distance_m: float) -> list[tuple[float, float]]:
    """Return the parts of a chain that lie within a distance of `point` (3,), as arc lengths, metres.

    On a closed chain, a part across the first point is one part. It exceeds the length of the chain.
    """
    is_near = np.linalg.norm(chain.points - point, axis=1) <= distance_m
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_near, [False]])))
    s = chain.arc_length_m
    parts = [(float(s[start]), float(s[stop - 1])) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    if not (chain.closed and is_near[0] and is_near[-1]):
        return parts
    if len(parts) == 1:
        return [(0.0, chain.length_m)]
    first, *others, last = parts
    return [*others, (last[0], chain.length_m + first[1])]
