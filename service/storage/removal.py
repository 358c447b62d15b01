"""Removal of a scan or a recording from the store, with everything that belongs only to it."""

import shutil
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from service.states import ACTIVE_STATES
from service.storage.store import Store

Kind = Literal["scan", "recording"]


@dataclass(frozen=True)
class Candidate:
    """A scan or recording that may be removed."""

    kind: Kind
    id: str
    at: str
    """Time when the scan ended, or when the recording was uploaded."""


_ENDED = f"kept = 0 AND ended_at IS NOT NULL AND state NOT IN ({', '.join('?' * len(ACTIVE_STATES))})"


def oldest_first(store: Store, until: str) -> list[Candidate]:
    """Return scans that ended before `until` and need not be kept, and older recordings without a scan."""
    sql = (
        f"SELECT 'scan' AS kind, id, ended_at AS at FROM scans WHERE {_ENDED} AND ended_at < ? "
        "UNION ALL SELECT 'recording', id, created_at FROM recordings "
        "WHERE created_at < ? AND NOT EXISTS (SELECT 1 FROM scans WHERE scans.recording = recordings.id) "
        "ORDER BY at, id"
    )
    return store.database.all(lambda row: Candidate(**dict(row)), sql, *ACTIVE_STATES, until, until)


def remove(store: Store, kind: Kind, row_id: str) -> int | None:
    """Remove the rows in one transaction, then the files.

    A recording is removed with its last scan. The hand-eye errors that scans estimate stay. A crash between rows and
    files leaves files without a row.

    Returns:
        Bytes freed; None if it must not be removed any more.

    Raises:
        sqlite3.Error: Nothing was removed.
        OSError: A file could not be removed. It has no row any more.
    """
    remove_rows = _remove_scan if kind == "scan" else _remove_recording
    with store.database.transaction() as db:
        gone = remove_rows(store, db, row_id)
    return sum(map(_remove_file, gone)) if gone else None


def tree_bytes(folder: Path) -> int:
    """Return the size of all files in a folder and its subfolders, bytes."""
    return sum(part.stat().st_size for part in folder.rglob("*") if part.is_file())


def _remove_scan(store: Store, db: sqlite3.Connection, scan_id: str) -> list[Path]:
    found = db.execute(f"SELECT recording FROM scans WHERE id = ? AND {_ENDED}", (scan_id, *ACTIVE_STATES)).fetchone()
    if found is None:
        return []
    for table in ("events", "idempotency_keys", "views"):
        db.execute(f"DELETE FROM {table} WHERE scan = ?", (scan_id,))
    db.execute("UPDATE scans SET source = NULL WHERE source = ?", (scan_id,))
    db.execute("DELETE FROM scans WHERE id = ?", (scan_id,))
    gone = [store.folder.results(scan_id)]
    if found["recording"] is not None:
        return gone + _remove_recording(store, db, found["recording"])
    return [*gone, store.folder.recording(scan_id)]  # an unreadable file of a live scan


def _remove_recording(store: Store, db: sqlite3.Connection, recording_id: str) -> list[Path]:
    unused = "DELETE FROM recordings WHERE id = ? AND NOT EXISTS (SELECT 1 FROM scans WHERE recording = ?)"
    removed = db.execute(unused, (recording_id, recording_id)).rowcount
    return [store.folder.recording(recording_id)] if removed else []


def _remove_file(path: Path) -> int:
    """Remove a file or folder, and return its size in bytes; 0 if there was none."""
    if path.is_dir():
        size = tree_bytes(path)
        shutil.rmtree(path)
        return size
    try:
        size = path.stat().st_size
        path.unlink()
    except FileNotFoundError:
        return 0
    return size
