"""The store of recordings and scans: rows in SQLite, bulk data in files.

A row is written after its file is in place and synced. A crash in between leaves a file without a row, never a row
without a file. Every call may block, so none belongs on the event loop.
"""

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from cell.recording.hashed_file import WrittenRange
from service.errors import Failure
from service.logs.setup import scan_log_context
from service.states import ACTIVE_STATES, ScanState, ViewState
from service.storage.calibration_store import CalibrationStore
from service.storage.data_folder import DataFolder
from service.storage.database import Database, now, update
from service.storage.event_log import ScanEvents
from service.storage.queries import EVERY_SCAN, ScanFilter, select_scans
from service.storage.rows import KeyRow, RecordingRow, ScanRow, ViewRow, insert, to_recording, to_scan

log = logging.getLogger(__name__)

KEPT = "what was recorded, if anything was, is kept: a scan that has a recording can be reprocessed"
"""Message of a scan that was interrupted or could not be stored."""

_MARK_MISSING = (
    "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND state = 'moving' RETURNING view"
)


class Store:
    """Rows of recordings and scans, and the order in which rows and files are written. Safe to use from any thread."""

    def __init__(self, folder: DataFolder) -> None:
        """Open the store in a data folder.

        Raises:
            StoreVersionError: The database belongs to a later version of the software.
        """
        self.folder = folder
        self.database = Database(folder.database)
        self.calibrations = CalibrationStore(self.database)
        self.events = ScanEvents(self.database)

    def close(self) -> None:
        """Close all connections. The store must not be used any more."""
        self.database.close()

    # Recordings

    def add_recording(self, row: RecordingRow, received: Path) -> None:
        """Move the synced file `received` into the store and write its row."""
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
        """Write the row of a recording that a live scan made in place. Both have the same id and time."""
        with self.database.transaction() as db:
            insert(db, "recordings", row)
            db.execute("UPDATE scans SET recording = ? WHERE id = ?", (row.id, row.id))
            created_at = "(SELECT created_at FROM scans WHERE scans.id = recordings.id)"
            db.execute(f"UPDATE recordings SET created_at = {created_at} WHERE id = ?", (row.id,))

    def recording(self, recording_id: str) -> RecordingRow | None:
        """Return the recording with this id; None if there is none."""
        return self.database.one(to_recording, "SELECT * FROM recordings WHERE id = ?", recording_id)

    def recordings(self, limit: int, before: str | None = None) -> list[RecordingRow]:
        """Return the newest recordings, or the newest of those that are older than the id `before`."""
        sql = "SELECT * FROM recordings WHERE id < ? ORDER BY id DESC LIMIT ?"
        return self.database.all(to_recording, sql, before or "~", limit)

    # Scans

    def add_scan(self, row: ScanRow, key: KeyRow | None = None) -> None:
        """Write the row of a new scan and the idempotency key of its request. On return both are on disk."""
        with self.events.transaction() as change:
            insert(change.db, "scans", row)
            if key is not None:
                insert(change.db, "idempotency_keys", key)
            change.state(row.id)

    def scan(self, scan_id: str) -> ScanRow | None:
        """Return the scan with this id; None if there is none."""
        return self.database.one(to_scan, "SELECT * FROM scans WHERE id = ?", scan_id)

    def scans(self, limit: int, before: str | None = None, matching: ScanFilter = EVERY_SCAN) -> list[ScanRow]:
        """Return the newest matching scans, or the newest of those that are older than the id `before`."""
        sql, values = select_scans(matching, before, limit)
        return self.database.all(to_scan, sql, *values)

    def key(self, caller: str, key: str) -> KeyRow | None:
        """Return the row of an idempotency key of a caller; None if the key was not used."""
        sql = "SELECT * FROM idempotency_keys WHERE caller = ? AND idempotency_key = ?"
        return self.database.one(lambda row: KeyRow(**dict(row)), sql, caller, key)

    def keep_scan(self, scan_id: str, kept: bool) -> bool:
        """Mark a scan to be kept, or no longer. Return False if there is no such scan."""
        with self.database.transaction() as db:
            return db.execute("UPDATE scans SET kept = ? WHERE id = ?", (kept, scan_id)).rowcount == 1

    def update_scan(self, scan_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Set columns of a scan if its state is one of `only_in`. Return whether they were set."""
        with self.events.transaction() as change:
            done = update(change.db, "scans", scan_id, only_in, values)
            if done and "state" in values:
                change.state(scan_id)
            elif done and values.keys() & {"stage", "fraction"}:
                change.progress(scan_id)
            return done

    def end_scan(self, scan_id: str, state: ScanState, failure: Failure) -> None:
        """End a scan without a result. A view that was being taken becomes missing."""
        with self.events.transaction() as change:
            values = {"state": state, "failure": failure, "ended_at": now()}
            if not update(change.db, "scans", scan_id, ACTIVE_STATES, values):
                return
            reason = "the scan ended before this view was taken"
            for (view,) in change.db.execute(_MARK_MISSING, (reason, now(), scan_id)).fetchall():
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
        """Move the results into place, then write the final row of the scan. After an error no folder is left.

        Args:
            scan_id: Id of the scan.
            state: Final state.
            summary: Short form of the result, as JSON.
            results: Folder whose files are synced.
            files: SHA-256 and size of each file, as JSON.
        """
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
        """Write the state of a view and its byte range in the recording. On return it is on disk."""
        where = (None, None, None) if written is None else (written.offset_bytes, written.size_bytes, written.sha256)
        with self.events.transaction() as change:
            change.db.execute("DELETE FROM views WHERE scan = ? AND view = ?", (scan_id, view))
            change.view(scan_id, view, state, reason)
            insert(change.db, "views", ViewRow(scan_id, view, state, reason, now(), *where))

    def views(self, scan_ids: Sequence[str]) -> list[ViewRow]:
        """Return the views of these scans, in order."""
        marks = ", ".join("?" * len(scan_ids))
        sql = f"SELECT * FROM views WHERE scan IN ({marks}) ORDER BY scan, view"
        return self.database.all(lambda row: ViewRow(**dict(row)), sql, *scan_ids)

    def scans_without_recording(self) -> list[ScanRow]:
        """Return live scans without the row of a recording. Some may have the file of one."""
        return self.database.all(to_scan, "SELECT * FROM scans WHERE mode = 'live' AND recording IS NULL ORDER BY id")

    def interrupt_unfinished(self) -> None:
        """Mark scans that ran when the service ended as `interrupted`. Called when the service starts."""
        marks = ", ".join("?" * len(ACTIVE_STATES))
        found = self.database.all(to_scan, f"SELECT * FROM scans WHERE state IN ({marks}) ORDER BY id", *ACTIVE_STATES)
        for scan in found:
            # The results may be in place already. Without the final row they do not count.
            if self.folder.results(scan.id).exists():
                shutil.rmtree(self.folder.results(scan.id))
            detail = f"the service ended while this scan was under way; {KEPT}"
            self.end_scan(scan.id, "interrupted", Failure("interrupted", detail))
            with scan_log_context(scan.id):
                log.warning("scan %s is interrupted: it was %s; %s", scan.id, scan.state, detail)
