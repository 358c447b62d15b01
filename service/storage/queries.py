"""Queries for lists of scans."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from service.clock import format_utc
from service.states import ScanState


@dataclass(frozen=True)
class ScanFilter:
    """Conditions that scans of a list meet. None and () mean no condition."""

    states: Sequence[ScanState] = ()
    """The state is one of these."""
    mode: Literal["replay", "live"] | None = None
    recording: str | None = None
    source: str | None = None
    kept: bool | None = None
    created_after: datetime | None = None
    """Exclusive, with a time zone."""
    created_before: datetime | None = None
    """Exclusive, with a time zone."""


EVERY_SCAN = ScanFilter()


def select_scans(matching: ScanFilter, before: str | None, limit: int) -> tuple[str, list[Any]]:
    """Return the SQL for the newest matching scans, and the values of its placeholders.

    Args:
        matching: Conditions.
        before: Only scans that are older than this id; None for no limit.
        limit: Maximum number of scans.
    """
    after, until = matching.created_after, matching.created_before
    candidates: list[tuple[str, Any]] = [
        ("id < ?", before),
        ("mode = ?", matching.mode),
        ("recording = ?", matching.recording),
        ("source = ?", matching.source),
        ("kept = ?", matching.kept),
        ("created_at > ?", None if after is None else format_utc(after)),
        # Times are cut to the millisecond, so the limit is rounded up.
        ("created_at < ?", None if until is None else format_utc(until, up=True)),
    ]
    conditions = [condition for condition, value in candidates if value is not None]
    values = [value for _, value in candidates if value is not None]
    if matching.states:
        conditions.append(f"state IN ({', '.join('?' * len(matching.states))})")
        values += matching.states
    where = f"WHERE {' AND '.join(conditions)} " if conditions else ""
    return f"SELECT * FROM scans {where}ORDER BY id DESC LIMIT ?", [*values, limit]
