"""Calibrations by the cell, and what scans tell of the one in use, as rows that survive a restart.

Pictures, corners and results lie in files beside them; a row tells of a file once it is in its place.
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from cell.control.calibration_run import BoardObservation
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
    """The rows. Safe to use from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, row: CalibrationRow) -> None:
        """Writes a new row; on return it is on the disk."""
        with self._database.transaction() as db:
            insert(db, TABLE, row)

    def get(self, calibration_id: str) -> CalibrationRow | None:
        """The calibration, or None when there is none of this id."""
        return self._database.one(to_calibration, f"SELECT * FROM {TABLE} WHERE id = ?", calibration_id)

    def newest(self, limit: int, before: str | None) -> list[CalibrationRow]:
        """The newest, those made before the id `before` if given."""
        sql = f"SELECT * FROM {TABLE} WHERE id < ? ORDER BY id DESC LIMIT ?"
        return self._database.all(to_calibration, sql, before or "~", limit)

    def last_verification(self, calibration_sha256: str) -> CalibrationRow | None:
        """The newest that came to an end of the calibration in use of this hash."""
        sql = (
            f"SELECT * FROM {TABLE} WHERE kind = 'verification' AND state = 'succeeded' AND calibration_sha256 = ? "
            "ORDER BY id DESC LIMIT 1"
        )
        return self._database.one(to_calibration, sql, calibration_sha256)

    def update(self, calibration_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Sets columns, unless the state is not one of `only_in`; says whether it did."""
        with self._database.transaction() as db:
            return update(db, TABLE, calibration_id, only_in, values)

    def end(self, calibration_id: str, state: ScanState, failure: Failure) -> None:
        """Ends one that has no result. A view that was under way is missing."""
        missed = (
            "UPDATE calibration_views SET state = 'missing', reason = ?, changed_at = ? "
            "WHERE calibration = ? AND state = 'moving'"
        )
        with self._database.transaction() as db:
            values = {"state": state, "failure": failure, "ended_at": now()}
            if update(db, TABLE, calibration_id, ACTIVE_STATES, values):
                db.execute(missed, ("the run ended before this view was taken", now(), calibration_id))

    def set_view(self, calibration_id: str, view: int, state: ViewState, reason: str | None = None) -> None:
        """Writes what became of a view; on return it is on the disk."""
        row = CalibrationViewRow(calibration_id, view, state, reason, None, None, now())
        with self._database.transaction() as db:
            db.execute("DELETE FROM calibration_views WHERE calibration = ? AND view = ?", (calibration_id, view))
            insert(db, "calibration_views", row)

    def set_seen(self, calibration_id: str, view: int, board: BoardObservation) -> None:
        """Writes what was found in a view's picture."""
        self._update_view(calibration_id, view, asdict(board))

    def set_unseen(self, calibration_id: str, view: int, reason: str) -> None:
        """Writes why nothing was found in a view's picture."""
        self._update_view(calibration_id, view, {"corners": 0, "cells": [], "reason": reason})

    def _update_view(self, calibration_id: str, view: int, values: dict[str, Any]) -> None:
        assignments = ", ".join(f"{name} = ?" for name in values)
        sql = f"UPDATE calibration_views SET {assignments}, changed_at = ? WHERE calibration = ? AND view = ?"
        with self._database.transaction() as db:
            db.execute(sql, (*map(stored, values.values()), now(), calibration_id, view))

    def views(self, calibration_ids: Sequence[str]) -> list[CalibrationViewRow]:
        """The views of these, in order."""
        marks = ", ".join("?" * len(calibration_ids))
        sql = f"SELECT * FROM calibration_views WHERE calibration IN ({marks}) ORDER BY calibration, view"
        return self._database.all(to_calibration_view, sql, *calibration_ids)

    def interrupt_unfinished(self) -> None:
        """At start-up: those that were under way when the service ended become `interrupted`."""
        marks = ", ".join("?" * len(ACTIVE_STATES))
        sql = f"SELECT * FROM {TABLE} WHERE state IN ({marks}) ORDER BY id"
        for row in self._database.all(to_calibration, sql, *ACTIVE_STATES):
            detail = f"the service ended while this {row.kind} was under way; start another"
            self.end(row.id, "interrupted", Failure("interrupted", detail))

    # What live scans tell of the calibration that they were made with

    def add_scan_error(self, row: ScanErrorRow) -> None:
        """Writes what a scan tells; its own row is there already."""
        with self._database.transaction() as db:
            insert(db, "scan_errors", row)

    def first_scan_errors(self, calibration_sha256: str, limit: int) -> list[ScanErrorRow]:
        """What the first scans by this calibration tell, in order."""
        sql = "SELECT * FROM scan_errors WHERE calibration_sha256 = ? ORDER BY scan LIMIT ?"
        return self._database.all(to_scan_error, sql, calibration_sha256, limit)

    def scan_errors(self, calibration_sha256: str, limit: int) -> list[ScanErrorRow]:
        """What the last scans by this calibration tell, the oldest first."""
        sql = "SELECT * FROM scan_errors WHERE calibration_sha256 = ? ORDER BY scan DESC LIMIT ?"
        return self._database.all(to_scan_error, sql, calibration_sha256, limit)[::-1]
