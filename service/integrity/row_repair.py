"""Rows that the service cannot tell, with as little changed as makes them readable: what hangs on them, as results, a
recording and views, keeps its place then."""

import json
import sqlite3
from collections.abc import Callable, Iterator
from typing import Any

from service.errors import Failure
from service.integrity.row_decoding import UnreadableRowError, readable_calibration, readable_scan
from service.storage.rows import stored

UNREADABLE = "its row was damaged; the row as it was is in lost+found: do it again"


def mended_row(db: sqlite3.Connection, table: str, values: dict[str, Any]) -> dict[str, Any] | None:
    """Which columns to set to what; none where the row is readable; None where nothing helps."""
    if table == "scans":
        return _first_readable(values, readable_scan, _scan_changes(db, values))
    if table == "calibrations":
        return _first_readable(values, readable_calibration, _calibration_changes(values))
    return None


def _first_readable(
    values: dict[str, Any], readable: Callable[[dict[str, Any]], object], changes: Iterator[dict[str, Any]]
) -> dict[str, Any] | None:
    """Each change comes on top of those before."""
    done: dict[str, Any] = {}
    for change in ({}, *changes):
        done |= change
        try:
            readable(values | done)
        except UnreadableRowError:
            continue
        return done
    return None


def _scan_changes(db: sqlite3.Connection, values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """From what is known for sure to what gives the result up."""
    event = _last_event(db, values["id"])
    yield {name: event[name] for name in ("state", "stage", "fraction") if name in event}
    yield {name: stored(event[name]) for name in ("failure", "summary") if name in event}
    yield {"files": None, "inputs": None}
    yield {"source": None, "asked_by": None, "calibration_sha256": None}
    yield _failed() | {"summary": None}


def _last_event(db: sqlite3.Connection, scan_id: object) -> dict[str, Any]:
    """What was written together with the scan's last state; nothing where that cannot be told."""
    sql = "SELECT data FROM events WHERE scan = ? AND kind = 'state' ORDER BY id DESC LIMIT 1"
    row = db.execute(sql, (scan_id,)).fetchone()
    try:
        event = json.loads(row["data"]) if row is not None else {}
    except (ValueError, TypeError):
        return {}
    return event if isinstance(event, dict) else {}


def _calibration_changes(values: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if values["result" if values["kind"] == "calibration" else "verification"]:
        # It is written together with the end.
        yield {"state": "succeeded", "stage": None, "fraction": 1.0, "failure": None}
    yield _failed()
    yield {"board": None, "coverage": 0.0, "warnings": "[]", "result": None, "verification": None}


def _failed() -> dict[str, Any]:
    failure = stored(Failure("damaged", UNREADABLE))
    return {"state": "failed", "stage": None, "fraction": 0.0, "failure": failure}
