"""Which scans a list is of, and how the database is asked for them."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from service.clock import stamp
from service.states import ScanState


@dataclass(frozen=True)
class ScanFilter:
    """What scans must have in common; None and () leave it open."""

    states: Sequence[ScanState] = ()
    """One of these."""
    mode: Literal["replay", "live"] | None = None
    recording: str | None = None
    source: str | None = None
    kept: bool | None = None
    created_after: datetime | None = None
    """Not at this moment itself; with a time zone."""
    created_before: datetime | None = None
    """Not at this moment itself; with a time zone."""


EVERY_SCAN = ScanFilter()


def select_scans(wanted: ScanFilter, before: str | None, limit: int) -> tuple[str, list[Any]]:
    """The SQL for the newest of the scans wanted, those made before the id `before` if given, and the values that
    belong to its question marks: nothing of a request becomes part of the SQL."""
    after, until = wanted.created_after, wanted.created_before
    asked: list[tuple[str, Any]] = [
        ("id < ?", before),
        ("mode = ?", wanted.mode),
        ("recording = ?", wanted.recording),
        ("source = ?", wanted.source),
        ("kept = ?", wanted.kept),
        ("created_at > ?", None if after is None else stamp(after)),
        # Stamps are cut to the millisecond: whatever was before the moment is before the next one too.
        ("created_at < ?", None if until is None else stamp(until, up=True)),
    ]
    conditions = [condition for condition, value in asked if value is not None]
    values = [value for _, value in asked if value is not None]
    if wanted.states:
        conditions.append(f"state IN ({', '.join('?' * len(wanted.states))})")
        values += wanted.states
    where = f"WHERE {' AND '.join(conditions)} " if conditions else ""
    return f"SELECT * FROM scans {where}ORDER BY id DESC LIMIT ?", [*values, limit]
