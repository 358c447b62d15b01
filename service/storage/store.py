"""The store: rows in SQLite, bulk data in files. It holds recordings, scans, calibrations and idempotency keys.

A row is written after its file is in place and synced. A crash in between leaves a file without a row, never a row
without a file. Every call may block, so none belongs on the event loop.
"""

from pathlib import Path

from calibration.atomic_write import sync_folder
from service.errors import JobKind
from service.storage.calibration_store import CalibrationStore
from service.storage.data_folder import DataFolder
from service.storage.database import Database
from service.storage.event_log import ScanEvents
from service.storage.rows import KeyRow, RecordingRow, insert, to_recording
from service.storage.scan_store import ScanStore


class Store:
    """Rows of recordings and idempotency keys, and the stores of scans and calibrations.

    Safe to use from any thread.
    """

    def __init__(self, folder: DataFolder) -> None:
        """Open the store in a data folder.

        Raises:
            StoreVersionError: The database belongs to a later version of the software, or to none of its releases.
        """
        self.folder = folder
        self.database = Database(folder.database)
        self.events = ScanEvents(self.database)
        self.scans = ScanStore(folder, self.database, self.events)
        self.calibrations = CalibrationStore(self.database)

    def jobs(self, kind: JobKind) -> ScanStore | CalibrationStore:
        """Return the store with the jobs of this kind. Both stores have `update`, `end` and `set_view`."""
        return self.scans if kind == "scan" else self.calibrations

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

    # Idempotency keys

    def key(self, caller: str, key: str) -> KeyRow | None:
        """Return the row of an idempotency key of a caller; None if the key was not used."""
        sql = "SELECT * FROM idempotency_keys WHERE caller = ? AND idempotency_key = ?"
        return self.database.one(lambda row: KeyRow(**dict(row)), sql, caller, key)
