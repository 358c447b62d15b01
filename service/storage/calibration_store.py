"""The store of calibration runs, and of the hand-eye errors that live scans estimate.

Images, corners and results are files. A row refers to a file after the file is in place.
"""

from collections.abc import Sequence
from typing import Any

from service.errors import Failure
from service.states import ACTIVE_STATES, ScanState, ViewState
from service.storage.database import Database, now, update
from service.storage.rows import (
    CalibrationRow,
    CalibrationViewRow,
    ScanErrorRow,
    insert,
    stored,
    to_calibration,
    to_calibration_view,
    to_scan_error,
)

TABLE = "calibrations"


class CalibrationStore:
    """Rows of calibrations and verifications. Safe to use from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, row: CalibrationRow) -> None:
        """Write a new row. On return it is on disk."""
        with self._database.transaction() as db:
            insert(db, TABLE, row)

    def get(self, calibration_id: str) -> CalibrationRow | None:
        """Return the run with this id; None if there is none."""
        return self._database.one(to_calibration, f"SELECT * FROM {TABLE} WHERE id = ?", calibration_id)

    def newest(self, limit: int, before: str | None) -> list[CalibrationRow]:
        """Return the newest runs, or the newest of those that are older than the id `before`."""
        sql = f"SELECT * FROM {TABLE} WHERE id < ? ORDER BY id DESC LIMIT ?"
        return self._database.all(to_calibration, sql, before or "~", limit)

    def last_verification(self, calibration_sha256: str) -> CalibrationRow | None:
        """Return the last verification of the calibration with this hash that succeeded; None if there is none."""
        sql = (
            f"SELECT * FROM {TABLE} WHERE kind = 'verification' AND state = 'succeeded' AND calibration_sha256 = ? "
            "ORDER BY id DESC LIMIT 1"
        )
        return self._database.one(to_calibration, sql, calibration_sha256)

    def update(self, calibration_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Set columns of a run if its state is one of `only_in`. Return whether they were set."""
        with self._database.transaction() as db:
            return update(db, TABLE, calibration_id, only_in, values)

    def end(self, calibration_id: str, state: ScanState, failure: Failure) -> None:
        """End a run without a result. A view that was being taken becomes missing."""
        mark_missing = (
            "UPDATE calibration_views SET state = 'missing', reason = ?, changed_at = ? "
            "WHERE calibration = ? AND state = 'moving'"
        )
        with self._database.transaction() as db:
            values = {"state": state, "failure": failure, "ended_at": now()}
            if update(db, TABLE, calibration_id, ACTIVE_STATES, values):
                db.execute(mark_missing, ("the run ended before this view was taken", now(), calibration_id))

    def set_view(
        self, calibration_id: str, view: int, state: ViewState, reason: str | None = None, **columns: Any
    ) -> None:
        """Write the state of a view, and further columns of its row. On return it is on disk."""
        row = CalibrationViewRow(calibration_id, view, state, reason, now(), **columns)
        with self._database.transaction() as db:
            db.execute("DELETE FROM calibration_views WHERE calibration = ? AND view = ?", (calibration_id, view))
            insert(db, "calibration_views", row)

    def update_view(self, calibration_id: str, view: int, **columns: Any) -> None:
        """Set columns of a view, such as the corners that were detected in its image."""
        assignments = ", ".join(f"{name} = ?" for name in columns)
        sql = f"UPDATE calibration_views SET {assignments}, changed_at = ? WHERE calibration = ? AND view = ?"
        with self._database.transaction() as db:
            db.execute(sql, (*map(stored, columns.values()), now(), calibration_id, view))

    def views(self, calibration_ids: Sequence[str]) -> list[CalibrationViewRow]:
        """Return the views of these runs, in order."""
        marks = ", ".join("?" * len(calibration_ids))
        sql = f"SELECT * FROM calibration_views WHERE calibration IN ({marks}) ORDER BY calibration, view"
        return self._database.all(to_calibration_view, sql, *calibration_ids)

    def interrupt_unfinished(self, before: str) -> None:
        """Mark runs that were active when an earlier service ended as `interrupted`.

        Args:
            before: Id that is later than theirs and earlier than those of this service.
        """
        marks = ", ".join("?" * len(ACTIVE_STATES))
        sql = f"SELECT * FROM {TABLE} WHERE state IN ({marks}) AND id < ? ORDER BY id"
        for row in self._database.all(to_calibration, sql, *ACTIVE_STATES, before):
            detail = f"the service ended while this {row.kind} was under way; start another"
            self.end(row.id, "interrupted", Failure("interrupted", detail))

    # Hand-eye errors that live scans estimate

    def add_scan_error(self, row: ScanErrorRow) -> None:
        """Write the error that a scan estimates."""
        with self._database.transaction() as db:
            insert(db, "scan_errors", row)

    def first_scan_errors(self, calibration_sha256: str, limit: int) -> list[ScanErrorRow]:
        """Return the errors that the first scans with this calibration estimate, the oldest first."""
        sql = "SELECT * FROM scan_errors WHERE calibration_sha256 = ? ORDER BY scan LIMIT ?"
        return self._database.all(to_scan_error, sql, calibration_sha256, limit)

    def scan_errors(self, calibration_sha256: str, limit: int) -> list[ScanErrorRow]:
        """Return the errors that the last scans with this calibration estimate, the oldest first."""
        sql = "SELECT * FROM scan_errors WHERE calibration_sha256 = ? ORDER BY scan DESC LIMIT ?"
        return self._database.all(to_scan_error, sql, calibration_sha256, limit)[::-1]
