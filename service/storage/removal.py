"""Removing a scan or a recording from the store, with all that belongs to it alone."""

import shutil
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from service.states import ACTIVE_STATES
from service.storage.store import Store


@dataclass(frozen=True)
class Old:
    """What may be removed."""

    kind: Literal["scan", "recording"]
    id: str
    at: str
    """When the scan ended, or the recording was sent."""


_ENDED = f"kept = 0 AND ended_at IS NOT NULL AND state NOT IN ({', '.join('?' * len(ACTIVE_STATES))})"


def oldest_first(store: Store, until: str) -> list[Old]:
    """Scans that ended before the stamp `until` and need not be kept, and recordings of no scan that came before it."""
    sql = (
        f"SELECT 'scan' AS kind, id, ended_at AS at FROM scans WHERE {_ENDED} AND ended_at < ? "
        "UNION ALL SELECT 'recording', id, created_at FROM recordings "
        "WHERE created_at < ? AND NOT EXISTS (SELECT 1 FROM scans WHERE scans.recording = recordings.id) "
        "ORDER BY at, id"
    )
    return store.database.all(lambda row: Old(**dict(row)), sql, *ACTIVE_STATES, until, until)


def remove(store: Store, old: Old) -> int | None:
    """Removes it: the rows in one change, then the files. Bytes freed; None when it must not be removed any more.

    A recording goes with the last scan of it. What a scan has told of its calibration stays. A crash between rows and
    files leaves files that no row tells of.

    Raises:
        sqlite3.Error: nothing was removed.
        OSError: a file could not be removed; no row tells of it any more.
    """
    remove_rows = _remove_scan if old.kind == "scan" else _remove_recording
    with store.database.transaction() as db:
        gone = remove_rows(store, db, old.id)
    return sum(map(_remove_file, gone)) if gone else None


def tree_bytes(folder: Path) -> int:
    """Bytes of all files in a folder, those in its folders too."""
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
    return [*gone, store.folder.recording(scan_id)]  # what a live scan left, but nobody could read


def _remove_recording(store: Store, db: sqlite3.Connection, recording_id: str) -> list[Path]:
    unused = "DELETE FROM recordings WHERE id = ? AND NOT EXISTS (SELECT 1 FROM scans WHERE recording = ?)"
    removed = db.execute(unused, (recording_id, recording_id)).rowcount
    return [store.folder.recording(recording_id)] if removed else []


def _remove_file(path: Path) -> int:
    """Bytes that a file or folder had; 0 when there was none."""
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
