"""Findings of a model: what was excluded, what is uncertain, and what must not be used. Metres, base frame."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recognition.model.finding_types import FINDING_TYPES, FindingCode, Severity

Which = Literal["first", "last"]
"""An end of a chain."""
SEVERITIES: tuple[Severity, ...] = ("blocking", "doubt", "note")
"""All severities, the most serious first."""


@dataclass(frozen=True)
class Finding:
    """One statement about a model. `finding` makes it, with the severity of its code."""

    code: str
    """Machine-readable code, a key of `FINDING_TYPES`."""
    severity: Severity
    """`note` changes nothing, `doubt` may be otherwise, and `blocking` must not be acted on."""
    message: str
    """Description for people, with the position."""
    chains: tuple[int, ...] = ()
    """Ids of the chains that the finding concerns. Empty if it concerns no chain of the model."""
    crossing: int | None = None
    """Id of the crossing that the finding concerns."""
    end: Which | None = None
    """End of the only chain in `chains`."""
    s_range_m: tuple[float, float] | None = None
    """Part of the only chain in `chains`, as arc lengths, metres. None means the whole chain, or the crossing's passes.

    On a closed chain, the second arc length may exceed the length of the chain.
    """
    point_m: tuple[float, float, float] | None = None
    """Position, metres, base frame."""
    view: int | None = None
    """Index of the view that the finding concerns."""
    value: float | None = None
    """Measured value that led to the finding. `FINDING_TYPES` has its meaning and unit."""
    limit: float | None = None
    """Limit that `value` exceeds or does not reach, in the unit of `value`."""


def finding(
    code: FindingCode,
    message: str,
    *,
    chains: Sequence[int] = (),
    crossing: int | None = None,
    end: Which | None = None,
    s_range_m: tuple[float, float] | None = None,
    point: NDArray[np.float64] | None = None,
    view: int | None = None,
    value: float | None = None,
    limit: float | None = None,
) -> Finding:
    """Return a finding with the severity of its code.

    Args:
        code: Code of the finding.
        message: Description for people.
        chains: Ids of the chains that the finding concerns.
        crossing: Id of the crossing that the finding concerns.
        end: End of the only chain.
        s_range_m: Part of the only chain, as arc lengths, metres.
        point: (3,) position, metres, base frame.
        view: Index of the view that the finding concerns.
        value: Measured value, in the unit that `FINDING_TYPES` gives.
        limit: Limit of the value.
    """
    if s_range_m is not None:
        s_range_m = (float(s_range_m[0]), float(s_range_m[1]))
    point_m = None if point is None else (float(point[0]), float(point[1]), float(point[2]))
    return Finding(
        code=code,
        severity=FINDING_TYPES[code].severity,
        message=message,
        chains=tuple(chains),
        crossing=crossing,
        end=end,
        s_range_m=s_range_m,
        point_m=point_m,
        view=view,
        value=_as_float(value),
        limit=_as_float(limit),
    )


def _as_float(value: float | None) -> float | None:
    """Return a NumPy scalar as a float. None stays None."""
    return None if value is None else float(value)


def most_serious_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings sorted by severity, then by the order of `FINDING_TYPES`."""
    rank = {code: number for number, code in enumerate(FINDING_TYPES)}
    return tuple(
        sorted(findings, key=lambda found: (SEVERITIES.index(found.severity), rank.get(found.code, len(rank))))
    )
