"""Repair of unreadable rows, with as few changed columns as possible.

A repaired row keeps its id, so its results, recording and views still belong to it.
"""

import json
import sqlite3
from collections.abc import Callable, Iterator
from typing import Any

from service.errors import Failure
from service.integrity.row_decoding import UnreadableRowError, decode_calibration, decode_scan
from service.storage.rows import stored

UNREADABLE = "its database row was damaged; the original row is in lost+found: run it again"


def repaired_columns(db: sqlite3.Connection, table: str, values: dict[str, Any]) -> dict[str, Any] | None:
    """Return the columns to change, with their new values.

    Args:
        db: Connection to the database of the row.
        table: Table of the row.
        values: Columns of the row.

    Returns:
        An empty dictionary if the row is readable; None if no change makes it readable.
    """
    if table == "scans":
        return _first_readable(values, decode_scan, _scan_changes(db, values))
    if table == "calibrations":
        return _first_readable(values, decode_calibration, _calibration_changes(values))
    return None


def _first_readable(
    values: dict[str, Any], decode: Callable[[dict[str, Any]], object], changes: Iterator[dict[str, Any]]
) -> dict[str, Any] | None:
    """Apply the changes one after the other, each on top of the earlier ones, until the row is readable."""
    applied: dict[str, Any] = {}
    for change in ({}, *changes):
        applied |= change
        try:
            decode(values | applied)
        except UnreadableRowError:
            continue
        return applied
    return None


def _scan_changes(db: sqlite3.Connection, values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield changes, from values that are known for certain to a failed scan without a result."""
    event = _last_event(db, values["id"])
    yield {name: event[name] for name in ("state", "stage", "fraction") if name in event}
    yield {name: stored(event[name]) for name in ("failure", "summary") if name in event}
    yield {"files": None, "inputs": None}
    yield {"source": None, "requested_by": None, "calibration_sha256": None}
    yield _failed() | {"summary": None}


def _last_event(db: sqlite3.Connection, scan_id: object) -> dict[str, Any]:
    """Return the event that was written together with the last state of the scan; empty if none can be read."""
    sql = "SELECT data FROM events WHERE scan = ? AND kind = 'state' ORDER BY id DESC LIMIT 1"
    row = db.execute(sql, (scan_id,)).fetchone()
    try:
        event = json.loads(row["data"]) if row is not None else {}
    except (ValueError, TypeError):
        return {}
    return event if isinstance(event, dict) else {}


def _calibration_changes(values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if values["result" if values["kind"] == "calibration" else "verification"]:
        # the result is written together with the final state
        yield {"state": "succeeded", "stage": None, "fraction": 1.0, "failure": None}
    yield _failed()
    yield {"board": None, "coverage": 0.0, "warnings": "[]", "result": None, "verification": None}


def _failed() -> dict[str, Any]:
    failure = stored(Failure("damaged", UNREADABLE))
    return {"state": "failed", "stage": None, "fraction": 0.0, "failure": failure}
