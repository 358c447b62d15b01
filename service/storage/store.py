"""Recordings and scans that survive a restart: rows in SQLite, bulk in files beside it.

A row that says that something is there is written after the file is in place and synced; a crash between the
two leaves a file without a row, never a row without its file. Every call may block: none belongs on the
event loop.
"""

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from cell.recording.hashed_file import WrittenRange
from service.errors import Failure
from service.logs.setup import log_scan
from service.states import ACTIVE_STATES, ScanState, ViewState
from service.storage.calibration_store import CalibrationStore
from service.storage.data_folder import DataFolder
from service.storage.database import Database, now, update
from service.storage.event_log import ScanEvents
from service.storage.queries import EVERY_SCAN, ScanFilter, select_scans
from service.storage.rows import KeyRow, RecordingRow, ScanRow, ViewRow, insert, to_recording, to_scan

log = logging.getLogger(__name__)

KEPT = "what was recorded, if anything was, is kept: a scan that has a recording can be worked out again"
"""Of a scan that came to no end of its own."""

MISSED = (
    "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND state = 'moving' RETURNING view"
)


class Store:
    """The rows, and the moments at which files come into being. Safe to use from any thread."""

    def __init__(self, folder: DataFolder) -> None:
        """Raises StoreVersionError: the database is of a later version."""
        self.folder = folder
        self.database = Database(folder.database)
        self.calibrations = CalibrationStore(self.database)
        self.events = ScanEvents(self.database)

    def close(self) -> None:
        """Closes all connections; nothing may use the store any more."""
        self.database.close()

    # Recordings

    def add_recording(self, row: RecordingRow, received: Path) -> None:
        """Takes the synced file `received` into the store and writes its row."""
        final = self.folder.recording(row.id)
        received.rename(final)
        try:
            sync_folder(final.parent)
            with self.database.transaction() as db:
                insert(db, "recordings", row)
        except BaseException:
            final.unlink(missing_ok=True)
            raise

    def add_scan_recording(self, row: RecordingRow) -> None:
        """Writes the row of the recording that a live scan made in place; both have the same id and time."""
        with self.database.transaction() as db:
            insert(db, "recordings", row)
            db.execute("UPDATE scans SET recording = ? WHERE id = ?", (row.id, row.id))
            created_at = "(SELECT created_at FROM scans WHERE scans.id = recordings.id)"
            db.execute(f"UPDATE recordings SET created_at = {created_at} WHERE id = ?", (row.id,))

    def recording(self, recording_id: str) -> RecordingRow | None:
        """The recording, or None when there is none of this id."""
        return self.database.one(to_recording, "SELECT * FROM recordings WHERE id = ?", recording_id)

    def recordings(self, limit: int, before: str | None = None) -> list[RecordingRow]:
        """The newest recordings, those made before the id `before` if given."""
        sql = "SELECT * FROM recordings WHERE id < ? ORDER BY id DESC LIMIT ?"
        return self.database.all(to_recording, sql, before or "~", limit)

    # Scans

    def add_scan(self, row: ScanRow, key: KeyRow | None = None) -> None:
        """Writes a new scan's row, and the idempotency key of the request for it; on return both are on the disk."""
        with self.events.changing() as change:
            insert(change.db, "scans", row)
            if key is not None:
                insert(change.db, "idempotency_keys", key)
            change.state(row.id)

    def scan(self, scan_id: str) -> ScanRow | None:
        """The scan, or None when there is none of this id."""
        return self.database.one(to_scan, "SELECT * FROM scans WHERE id = ?", scan_id)

    def scans(self, limit: int, before: str | None = None, wanted: ScanFilter = EVERY_SCAN) -> list[ScanRow]:
        """The newest of the scans wanted, those made before the id `before` if given."""
        sql, values = select_scans(wanted, before, limit)
        return self.database.all(to_scan, sql, *values)

    def key(self, caller: str, key: str) -> KeyRow | None:
        """What a caller's idempotency key was used for, or None."""
        sql = "SELECT * FROM idempotency_keys WHERE caller = ? AND idempotency_key = ?"
        return self.database.one(lambda row: KeyRow(**dict(row)), sql, caller, key)

    def keep_scan(self, scan_id: str, kept: bool) -> bool:
        """Marks a scan as one to be kept for ever, or no longer; False: there is none of this id."""
        with self.database.transaction() as db:
            return db.execute("UPDATE scans SET kept = ? WHERE id = ?", (kept, scan_id)).rowcount == 1

    def update_scan(self, scan_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Sets columns of a scan, unless its state is not one of `only_in`; says whether it did."""
        with self.events.changing() as change:
            done = update(change.db, "scans", scan_id, only_in, values)
            if done and "state" in values:
                change.state(scan_id)
            elif done and values.keys() & {"stage", "fraction"}:
                change.progress(scan_id)
            return done

    def end_scan(self, scan_id: str, state: ScanState, failure: Failure) -> None:
        """Ends a scan that has no result. A view that was under way is missing."""
        with self.events.changing() as change:
            values = {"state": state, "failure": failure, "ended_at": now()}
            if not update(change.db, "scans", scan_id, ACTIVE_STATES, values):
                return
            reason = "the scan ended before this view was taken"
            for (view,) in change.db.execute(MISSED, (reason, now(), scan_id)).fetchall():
                change.view(scan_id, view, "missing", reason)
            change.state(scan_id)  # the last event of all

    def finish_scan(
        self,
        scan_id: str,
        state: ScanState,
        summary: dict[str, Any],
        results: Path,
        files: dict[str, Any] | None = None,
    ) -> None:
        """Puts the folder `results`, whose files are synced, in its place, then writes the scan's row, with the hashes
        of the `files`. What cannot be written leaves no folder behind."""
        final = self.folder.results(scan_id)
        sync_folder(results)
        results.rename(final)
        try:
            sync_folder(final.parent)
            ended = {"state": state, "stage": None, "fraction": 1.0, "ended_at": now()}
            self.update_scan(scan_id, summary=summary, files=files, **ended)
        except BaseException:
            shutil.rmtree(final, ignore_errors=True)
            raise

    def set_view(
        self, scan_id: str, view: int, state: ViewState, reason: str | None = None, written: WrittenRange | None = None
    ) -> None:
        """Writes what became of a viewpoint, and which bytes of its recording it is; on return it is on the disk."""
        where = (None, None, None) if written is None else (written.offset_bytes, written.size_bytes, written.sha256)
        with self.events.changing() as change:
            change.db.execute("DELETE FROM views WHERE scan = ? AND view = ?", (scan_id, view))
            change.view(scan_id, view, state, reason)
            insert(change.db, "views", ViewRow(scan_id, view, state, reason, now(), *where))

    def views(self, scan_ids: Sequence[str]) -> list[ViewRow]:
        """The viewpoints of these scans, in order."""
        marks = ", ".join("?" * len(scan_ids))
        sql = f"SELECT * FROM views WHERE scan IN ({marks}) ORDER BY scan, view"
        return self.database.all(lambda row: ViewRow(**dict(row)), sql, *scan_ids)

    def scans_without_recording(self) -> list[ScanRow]:
        """Live scans that have no recording in the store; some may have its file."""
        return self.database.all(to_scan, "SELECT * FROM scans WHERE mode = 'live' AND recording IS NULL ORDER BY id")

    def interrupt_unfinished(self) -> None:
        """At start-up: scans that were under way when the service ended become `interrupted`."""
        marks = ", ".join("?" * len(ACTIVE_STATES))
        found = self.database.all(to_scan, f"SELECT * FROM scans WHERE state IN ({marks}) ORDER BY id", *ACTIVE_STATES)
        for scan in found:
            # The results may have been put in place just before the end; without the row they do not count.
            if self.folder.results(scan.id).exists():
                shutil.rmtree(self.folder.results(scan.id))
            detail = f"the service ended while this scan was under way; {KEPT}"
            self.end_scan(scan.id, "interrupted", Failure("interrupted", detail))
            with log_scan(scan.id):
                log.warning("scan %s is interrupted: it was %s; %s", scan.id, scan.state, detail)
