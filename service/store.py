"""Recordings and scans that survive a restart: rows in SQLite, bulk in files beside it.

A row that says that something is there is written after the file is in place and synced; a crash between the
two leaves a file without a row, never a row without its file. Every call may block: none belongs on the
event loop.
"""

import queue
import secrets
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from service.data_folder import DataFolder, sync_folder
from service.problems import problem_document
from service.schemas import ACTIVE_STATES, ScanState, ViewState
from service.tables import MIGRATIONS, VERSION, RecordingRow, ScanRow, ViewRow, insert, stored, to_recording, to_scan

T = TypeVar("T")

BUSY_S = 5.0
"""How long a statement waits for another program that holds the database."""


class StoreVersionError(ValueError):
    """A database of a later version of this software."""

    slug = "store-version"


def new_id() -> str:
    """An id that is a safe file name and sorts by the moment of its making."""
    return f"{datetime.now(UTC):%Y%m%dt%H%M%S-%f}-{secrets.token_hex(4)}"


def now() -> str:
    """The present moment, RFC 3339 in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Store:
    """The rows, and the moments at which files come into being. Safe to use from any thread."""

    def __init__(self, folder: DataFolder) -> None:
        self.folder = folder
        self._free: queue.SimpleQueue[sqlite3.Connection] = queue.SimpleQueue()
        try:
            self._make_tables()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Closes all connections; nothing may use the store any more."""
        while not self._free.empty():
            self._free.get().close()

    # Recordings

    def add_recording(self, row: RecordingRow, received: Path) -> None:
        """Takes the synced file `received` into the store and writes its row."""
        final = self.folder.recording(row.id)
        received.rename(final)
        try:
            sync_folder(final.parent)
            with self._transaction() as db:
                insert(db, "recordings", row)
        except BaseException:
            final.unlink(missing_ok=True)
            raise

    def add_scan_recording(self, row: RecordingRow) -> None:
        """Writes the row of the recording that a live scan made in place; both have the same id."""
        with self._transaction() as db:
            insert(db, "recordings", row)
            db.execute("UPDATE scans SET recording = ? WHERE id = ?", (row.id, row.id))

    def recording(self, recording_id: str) -> RecordingRow | None:
        """The recording, or None when there is none of this id."""
        return self._one(to_recording, "SELECT * FROM recordings WHERE id = ?", recording_id)

    def recordings(self, limit: int, before: str | None) -> list[RecordingRow]:
        """The newest recordings, those made before the id `before` if given."""
        sql = "SELECT * FROM recordings WHERE id < ? ORDER BY id DESC LIMIT ?"
        return self._all(to_recording, sql, before or "~", limit)

    # Scans

    def add_scan(self, row: ScanRow) -> None:
        """Writes a new scan's row; on return it is on the disk."""
        with self._transaction() as db:
            insert(db, "scans", row)

    def scan(self, scan_id: str) -> ScanRow | None:
        """The scan, or None when there is none of this id."""
        return self._one(to_scan, "SELECT * FROM scans WHERE id = ?", scan_id)

    def scans(self, limit: int, before: str | None) -> list[ScanRow]:
        """The newest scans, those made before the id `before` if given."""
        return self._all(to_scan, "SELECT * FROM scans WHERE id < ? ORDER BY id DESC LIMIT ?", before or "~", limit)

    def update_scan(self, scan_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Sets columns of a scan, unless its state is not one of `only_in`; says whether it did."""
        with self._transaction() as db:
            return _update(db, scan_id, only_in, values)

    def end_scan(self, scan_id: str, state: ScanState, problem: dict[str, Any]) -> None:
        """Ends a scan that has no result. A view that was under way is missing."""
        missed = "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND state = 'moving'"
        with self._transaction() as db:
            if _update(db, scan_id, ACTIVE_STATES, {"state": state, "problem": problem, "ended_at": now()}):
                db.execute(missed, ("the scan ended before this view was taken", now(), scan_id))

    def finish_scan(self, scan_id: str, state: ScanState, summary: dict[str, Any], results: Path) -> None:
        """Puts the folder `results`, whose files are synced, in its place, then writes the scan's row."""
        final = self.folder.results(scan_id)
        sync_folder(results)
        results.rename(final)
        sync_folder(final.parent)
        self.update_scan(scan_id, state=state, summary=summary, stage=None, fraction=1.0, ended_at=now())

    def set_view(self, scan_id: str, view: int, state: ViewState, reason: str | None = None) -> None:
        """Writes what became of a viewpoint; on return it is on the disk."""
        with self._transaction() as db:
            db.execute("DELETE FROM views WHERE scan = ? AND view = ?", (scan_id, view))
            insert(db, "views", ViewRow(scan_id, view, state, reason, now()))

    def views(self, scan_ids: Sequence[str]) -> list[ViewRow]:
        """The viewpoints of these scans, in order."""
        marks = ", ".join("?" * len(scan_ids))
        sql = f"SELECT * FROM views WHERE scan IN ({marks}) ORDER BY scan, view"
        return self._all(lambda row: ViewRow(**dict(row)), sql, *scan_ids)

    def scans_without_recording(self) -> list[ScanRow]:
        """Live scans that have no recording in the store; some may have its file."""
        return self._all(to_scan, "SELECT * FROM scans WHERE mode = 'live' AND recording IS NULL ORDER BY id")

    def interrupt_unfinished(self) -> None:
        """At start-up: scans that were under way when the service ended become `interrupted`."""
        marks = ", ".join("?" * len(ACTIVE_STATES))
        found = self._all(to_scan, f"SELECT * FROM scans WHERE state IN ({marks}) ORDER BY id", *ACTIVE_STATES)
        for scan in found:
            # The results may have been put in place just before the end; without the row they do not count.
            if self.folder.results(scan.id).exists():
                shutil.rmtree(self.folder.results(scan.id))
            detail = "the service ended while this scan was under way; start it again from its recording"
            problem = problem_document(500, "interrupted", detail)
            self.end_scan(scan.id, "interrupted", problem)

    def check(self) -> None:
        """Asks the database for something; raises sqlite3.Error when it does not answer."""
        self._all(tuple, "SELECT 1")

    # SQLite

    def _make_tables(self) -> None:
        with self._transaction() as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version > VERSION:
                raise StoreVersionError(
                    f"{self.folder.database} has tables of version {version}, this software knows {VERSION}: "
                    "use a later release, or another data_dir"
                )
            for migration in MIGRATIONS[version:]:
                for statement in migration.split(";"):
                    db.execute(statement)
            db.execute(f"PRAGMA user_version = {VERSION}")

    @contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        try:
            connection = self._free.get_nowait()
        except queue.Empty:
            # Handed from thread to thread, but used by one at a time.
            connection = sqlite3.connect(self.folder.database, BUSY_S, check_same_thread=False)
            connection.isolation_level = None
            connection.row_factory = sqlite3.Row
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
        try:
            yield connection
        finally:
            self._free.put(connection)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._connection() as db:
            db.execute("BEGIN IMMEDIATE")
            try:
                yield db
                db.execute("COMMIT")
            except BaseException:
                if db.in_transaction:
                    db.execute("ROLLBACK")
                raise

    def _all(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> list[T]:
        with self._connection() as db:
            return [make(row) for row in db.execute(sql, values).fetchall()]

    def _one(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> T | None:
        rows = self._all(make, sql, *values)
        return rows[0] if rows else None


def _update(db: sqlite3.Connection, scan_id: str, only_in: Sequence[ScanState], values: dict[str, Any]) -> bool:
    assignments = ", ".join(f"{name} = ?" for name in values)
    sql = f"UPDATE scans SET {assignments} WHERE id = ? AND state IN ({', '.join('?' * len(only_in))})"
    return db.execute(sql, (*map(stored, values.values()), scan_id, *only_in)).rowcount == 1
