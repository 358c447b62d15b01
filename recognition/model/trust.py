"""Rules that turn findings into verdicts: on the model, on each chain, on each crossing, and on each part of a chain.

A finding that names chains concerns these chains: its `s_range_m`, the two passes of its crossing, or else the whole
chain. A finding that names no chain concerns the model only, for example because a string may be missing.

- Model: `refuse` if a blocking finding names no chain; `review` if there is another blocking finding or a doubt;
  otherwise `accept`.
- Chain: `refuse` if the model is refused, or if a blocking finding concerns the whole chain; `review` if a doubt or
  another blocking finding names the chain; otherwise `accept`.
- Crossing: `refuse` if one of its chains is refused; `review` if a doubt or a blocking finding names the crossing, or
  concerns the part of a chain at the crossing; otherwise `accept`.
- Position on a chain: trusted if no doubt and no blocking finding concerns the chain there.

Notes change no verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import Finding

Verdict = Literal["accept", "review", "refuse"]
"""`accept`: act. `review`: act on trusted parts only, scan again, or ask a person. `refuse`: do not act."""
Interval = tuple[float, float]
"""Arc lengths of the two ends of a part of a chain, metres."""
ROUNDING_M = 1e-5
"""Distance below which arc lengths count as equal, metres. Documents round arc lengths to a micrometre, and sums of
them differ by a few micrometres."""
CROSSING_PART_RADII = 3.0
"""Half length of the part of a chain that a finding on a crossing concerns, in radii: the extent of an intersection."""


@dataclass(frozen=True)
class ChainTrust:
    """Verdict on a chain, and the parts of the chain with a doubt or a blocking finding."""

    verdict: Verdict
    """Verdict on the chain."""
    length_m: float
    """Length of the chain, metres."""
    closed: bool
    """Whether the last point of the chain connects to the first."""
    doubtful_m: tuple[Interval, ...]
    """Parts with a doubt or a blocking finding, within 0 to `length_m`, in order and without overlaps."""

    @property
    def trusted_m(self) -> tuple[Interval, ...]:
        """The other parts of the chain, in order."""
        starts = [0.0, *(stop for _, stop in self.doubtful_m)]
        stops = [*(start for start, _ in self.doubtful_m), self.length_m]
        return tuple((start, stop) for start, stop in zip(starts, stops, strict=True) if start < stop)

    def is_trusted(self, s_m: float, half_length_m: float = 0.0) -> bool:
        """Return whether no doubtful part overlaps the part of the chain about a position.

        Args:
            s_m: Arc length of the position, metres. Beyond an end of an open chain, the position is the end.
            half_length_m: Half length of the part about the position, metres.
        """
        if self.closed:
            positions = (s_m - self.length_m, s_m, s_m + self.length_m)
        else:
            positions = (min(max(s_m, 0.0), self.length_m),)
        for start, stop in self.doubtful_m:
            if any(start <= s + half_length_m and s - half_length_m <= stop for s in positions):
                return False
        return True


def model_verdict(findings: Sequence[Finding]) -> Verdict:
    """Return the verdict on the whole model."""
    if any(finding.severity == "blocking" and not finding.chains for finding in findings):
        return "refuse"
    return "review" if any(finding.severity != "note" for finding in findings) else "accept"


def chain_trust(chain: Chain, crossings: Sequence[Crossing], findings: Sequence[Finding]) -> ChainTrust:
    """Return the verdict on a chain, and its doubtful parts.

    Args:
        chain: Chain of the model.
        crossings: All crossings of the model.
        findings: All findings of the model.
    """
    length = chain.length_m
    if model_verdict(findings) == "refuse":
        return ChainTrust("refuse", length, chain.closed, ((0.0, length),))
    serious = [finding for finding in findings if finding.severity != "note" and chain.id in finding.chains]
    whole = [finding for finding in serious if finding.s_range_m is None and finding.crossing is None]
    if whole:
        verdict = "refuse" if any(finding.severity == "blocking" for finding in whole) else "review"
        return ChainTrust(verdict, length, chain.closed, ((0.0, length),))
    verdict = "review" if serious else "accept"
    parts: list[Interval] = []
    for finding in serious:
        parts += _parts(finding, chain, crossings)
    return ChainTrust(verdict, length, chain.closed, _merged(parts, length, chain.closed))


def crossing_verdict(crossing: Crossing, trusts: Sequence[ChainTrust], findings: Sequence[Finding]) -> Verdict:
    """Return the verdict on a crossing.

    Args:
        crossing: Crossing of the model.
        trusts: Trust of its two chains, in the order over, under.
        findings: All findings of the model.
    """
    if any(trust.verdict == "refuse" for trust in trusts):
        return "refuse"
    is_named = any(finding.severity != "note" and finding.crossing == crossing.id for finding in findings)
    passes = zip(trusts, (crossing.over, crossing.under), strict=True)
    return "review" if is_named or not all(trust.is_trusted(at.s_m) for trust, at in passes) else "accept"


def _parts(finding: Finding, chain: Chain, crossings: Sequence[Crossing]) -> list[Interval]:
    """Return the parts of the chain that a finding concerns, as arc lengths that may lie beyond the ends, metres."""
    if finding.s_range_m is not None:
        return [finding.s_range_m]
    half = CROSSING_PART_RADII * chain.radius_m
    positions: list[StrandPoint] = []
    for crossing in crossings:
        if crossing.id == finding.crossing:
            positions += [crossing.over, crossing.under]
    return [(at.s_m - half, at.s_m + half) for at in positions if at.chain == chain.id]


def _merged(parts: Sequence[Interval], length: float, closed: bool) -> tuple[Interval, ...]:
    """Return the parts within 0 to `length`, in order and without overlaps. On a closed chain, parts wrap around."""
    if closed and length > 0:
        parts = [(start % length, start % length + stop - start) for start, stop in parts]
        parts += [(start - length, stop - length) for start, stop in parts]
    clipped = [_clipped(start, stop, length) for start, stop in parts if start <= length and stop >= 0.0]
    merged: list[Interval] = []
    for start, stop in sorted(clipped):
        if merged and start <= merged[-1][1] + ROUNDING_M:
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return tuple(merged)


def _clipped(start: float, stop: float, length: float) -> Interval:
    """Return a part of a chain within 0 to `length`. Its ends snap to those of the chain."""
    if start <= ROUNDING_M:
        start = 0.0
    if stop >= length - ROUNDING_M:
        stop = length
    return start, stop
