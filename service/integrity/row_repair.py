"""Repair of unreadable rows: they are rebuilt from their readable columns and from what else the database says.

The files of a scan or calibration do not name its recording, requester, inputs or mark, so no row can be rebuilt from
them alone. A rebuilt row keeps its id, so its results, recording and views still belong to it.
"""

import json
import sqlite3
from typing import Any

from service.errors import Failure
from service.integrity.row_decoding import UnreadableRowError, decode_row
from service.storage.rows import stored

_UNKNOWN: dict[str, dict[str, Any]] = {
    "scans": dict.fromkeys(("files", "inputs", "source", "requested_by", "calibration_sha256")),
    "calibrations": {"board": None, "coverage": 0.0, "warnings": "[]", "result": None, "verification": None},
}
"""Columns that a row can do without, each with the value for an unknown one."""
_DAMAGED = Failure("damaged", "its database row was damaged; the original row is in lost+found: run it again")
_FAILED = {"state": "failed", "stage": None, "fraction": 0.0, "failure": stored(_DAMAGED)}


def rebuild_row(db: sqlite3.Connection, table: str, values: dict[str, Any]) -> dict[str, Any] | None:
    """Rebuild a row with its own outcome, else with the known one, else as failed.

    Args:
        db: Connection to the database of the row.
        table: Table of the row.
        values: Columns of the row.

    Returns:
        All columns; None if the row cannot be rebuilt.
    """
    if table not in _UNKNOWN:
        return None
    failed = _FAILED | ({"summary": None, "files": None} if table == "scans" else {})
    for outcome in ({}, _known_outcome(db, table, values), failed):
        row = values | _UNKNOWN[table] | outcome
        if _is_readable(table, row):
            known = {name: values[name] for name in _UNKNOWN[table]}
            return row | {n: v for n, v in known.items() if n not in outcome and _is_readable(table, row | {n: v})}
    return None


def _is_readable(table: str, values: dict[str, Any]) -> bool:
    try:
        decode_row(table, values)
    except UnreadableRowError:
        return False
    return True


def _known_outcome(db: sqlite3.Connection, table: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return what was written together with the last state of the scan, or with the result of the calibration."""
    if table == "calibrations":
        result = values["result" if values["kind"] == "calibration" else "verification"]
        return _FAILED | {"state": "succeeded", "fraction": 1.0, "failure": None} if result else {}
    sql = "SELECT data FROM events WHERE scan = ? AND kind = 'state' ORDER BY id DESC LIMIT 1"
    row = db.execute(sql, (values["id"],)).fetchone()
    try:
        event = json.loads(row["data"])
        return {name: stored(event[name]) for name in (*_FAILED, "summary") if name in event}
    except (ValueError, TypeError):  # no event, or an unreadable one
        return {}
