"""Findings of a model: what was excluded, what is uncertain, and what must not be used. Metres, base frame."""

from dataclasses import dataclass
from typing import TypeAlias

Severity: TypeAlias = str
"""`note` changes nothing, `doubt` may be otherwise, and `blocking` must not be acted on."""
Verdict: TypeAlias = str
"""`accept`: act. `review`: act on trusted parts only, scan again, or ask a person. `refuse`: do not act."""


@dataclass(frozen=True)
class Finding:
    """One statement about a model."""

    code: str
    """Machine-readable code. Later services may add codes, so decide by `severity` if a code is unknown."""
    severity: Severity
    """`note`, `doubt` or `blocking`."""
    message: str
    """Description for people."""
    chains: tuple[int, ...] = ()
    """Ids of the chains that the finding concerns. Empty if it concerns no chain, or the whole model."""
    crossing: int | None = None
    """Id of the crossing that the finding concerns."""
    end: str | None = None
    """End of the only chain in `chains`, `first` or `last`."""
    s_range_m: tuple[float, float] | None = None
    """Part of the only chain in `chains`, as arc lengths, metres. It may exceed the length of a ring."""
    point_m: tuple[float, float, float] | None = None
    """Position, metres, base frame."""
    view: int | None = None
    """Index of the view that the finding concerns."""
    value: float | None = None
    """Measured value that led to the finding. The code determines its meaning and unit."""
    limit: float | None = None
    """Limit of the value, in the same unit."""
