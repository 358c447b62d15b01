"""The store of scans and their views.

A row with a result is written after the files are in place and synced. A crash in between leaves files without a row,
never a row without files.
"""

import logging
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from calibration.atomic_write import sync_folder
from service.clock import format_utc
from service.errors import Failure
from service.logs.setup import scan_log_context
from service.states import ACTIVE_STATES, ScanState, ViewState
from service.storage.data_folder import DataFolder
from service.storage.database import Database, now, update
from service.storage.event_log import ScanEvents
from service.storage.rows import KeyRow, ScanRow, ViewRow, insert, stored, to_scan

log = logging.getLogger(__name__)

KEPT = "what was recorded, if anything was, is kept: a scan that has a recording can be reprocessed"
"""Message of a scan that was interrupted or could not be stored."""

_MARK_MISSING = (
    "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND state = 'moving' RETURNING view"
)


@dataclass(frozen=True)
class ScanFilter:
    """Conditions that scans of a list meet. None and () mean no condition."""

    states: Sequence[ScanState] = ()
    """The state is one of these."""
    mode: Literal["replay", "live"] | None = None
    recording: str | None = None
    source: str | None = None
    kept: bool | None = None
    created_after: datetime | None = None
    """Exclusive, with a time zone."""
    created_before: datetime | None = None
    """Exclusive, with a time zone."""


EVERY_SCAN = ScanFilter()


class ScanStore:
    """Rows of scans and of their views. Safe to use from any thread.

    Each change of a state, of the progress or of a view is also an event of `events`, in the same transaction.
    """

    def __init__(self, folder: DataFolder, database: Database, events: ScanEvents) -> None:
        self._folder, self._database, self._events = folder, database, events

    def add(self, row: ScanRow, key: KeyRow | None = None) -> None:
        """Write the row of a new scan and the idempotency key of its request. On return both are on disk."""
        with self._events.transaction() as change:
            insert(change.db, "scans", row)
            if key is not None:
                insert(change.db, "idempotency_keys", key)
            change.state(row.id)

    def get(self, scan_id: str) -> ScanRow | None:
        """Return the scan with this id; None if there is none."""
        return self._database.one(to_scan, "SELECT * FROM scans WHERE id = ?", scan_id)

    def newest(self, limit: int, before: str | None = None, matching: ScanFilter = EVERY_SCAN) -> list[ScanRow]:
        """Return the newest matching scans, or the newest of those that are older than the id `before`."""
        sql, values = _select_scans(matching, before, limit)
        return self._database.all(to_scan, sql, *values)

    def keep(self, scan_id: str, kept: bool) -> bool:
        """Mark a scan to be kept, or no longer. Return False if there is no such scan."""
        with self._database.transaction() as db:
            return db.execute("UPDATE scans SET kept = ? WHERE id = ?", (kept, scan_id)).rowcount == 1

    def set_timing(self, scan_id: str, timing: dict[str, Any]) -> None:
        """Write the durations of a scan, in any state. This is no event."""
        with self._database.transaction() as db:
            db.execute("UPDATE scans SET timing = ? WHERE id = ?", (stored(timing), scan_id))

    def add_file(self, scan_id: str, name: str, hash_and_size: dict[str, Any]) -> None:
        """Write hash and size of a file that was added to the result of a scan. This is no event."""
        sql = "UPDATE scans SET files = json_set(coalesce(files, '{}'), '$.\"' || ? || '\"', json(?)) WHERE id = ?"
        with self._database.transaction() as db:
            db.execute(sql, (name, stored(hash_and_size), scan_id))

    def update(self, scan_id: str, only_in: Sequence[ScanState] = ACTIVE_STATES, **values: Any) -> bool:
        """Set columns of a scan if its state is one of `only_in`. Return whether they were set."""
        with self._events.transaction() as change:
            done = update(change.db, "scans", scan_id, only_in, values)
            if done and "state" in values:
                change.state(scan_id)
            elif done and values.keys() & {"stage", "fraction"}:
                change.progress(scan_id)
            return done

    def end(self, scan_id: str, state: ScanState, failure: Failure) -> None:
        """End a scan without a result. A view that was being taken becomes missing."""
        with self._events.transaction() as change:
            values = {"state": state, "failure": failure, "ended_at": now()}
            if not update(change.db, "scans", scan_id, ACTIVE_STATES, values):
                return
            reason = "the scan ended before this view was taken"
            for (view,) in change.db.execute(_MARK_MISSING, (reason, now(), scan_id)).fetchall():
                change.view(scan_id, view, "missing", reason)
            change.state(scan_id)  # the last event of all

    def finish(
        self,
        scan_id: str,
        state: ScanState,
        summary: dict[str, Any],
        results: Path,
        files: dict[str, Any] | None = None,
        timing: dict[str, Any] | None = None,
    ) -> None:
        """Move the results into place, then write the final row of the scan. After an error no folder is left.

        Args:
            scan_id: Id of the scan.
            state: Final state.
            summary: Short form of the result, as JSON.
            results: Folder whose files are synced.
            files: SHA-256 and size of each file, as JSON.
            timing: Durations of the scan so far, as JSON.
        """
        final = self._folder.results(scan_id)
        sync_folder(results)
        results.rename(final)
        try:
            sync_folder(final.parent)
            ended = {"state": state, "stage": None, "fraction": 1.0, "ended_at": now()}
            self.update(scan_id, summary=summary, files=files, timing=timing, **ended)
        except BaseException:
            shutil.rmtree(final, ignore_errors=True)
            raise

    def set_view(self, scan_id: str, view: int, state: ViewState, reason: str | None = None, **columns: Any) -> None:
        """Write the state of a view, and further columns of its row. On return it is on disk."""
        with self._events.transaction() as change:
            change.db.execute("DELETE FROM views WHERE scan = ? AND view = ?", (scan_id, view))
            change.view(scan_id, view, state, reason)
            insert(change.db, "views", ViewRow(scan_id, view, state, reason, now(), **columns))

    def views(self, scan_ids: Sequence[str]) -> list[ViewRow]:
        """Return the views of these scans, in order."""
        marks = ", ".join("?" * len(scan_ids))
        sql = f"SELECT * FROM views WHERE scan IN ({marks}) ORDER BY scan, view"
        return self._database.all(lambda row: ViewRow(**dict(row)), sql, *scan_ids)

    def without_recording(self, before: str) -> list[ScanRow]:
        """Return live scans without the row of a recording. Some may have the file of one.

        Args:
            before: Id that is later than those of the scans.
        """
        sql = "SELECT * FROM scans WHERE mode = 'live' AND recording IS NULL AND id < ? ORDER BY id"
        return self._database.all(to_scan, sql, before)

    def interrupt_unfinished(self, before: str) -> None:
        """Mark scans that ran when an earlier service ended as `interrupted`.

        Args:
            before: Id that is later than theirs and earlier than those of this service.
        """
        marks = ", ".join("?" * len(ACTIVE_STATES))
        sql = f"SELECT * FROM scans WHERE state IN ({marks}) AND id < ? ORDER BY id"
        found = self._database.all(to_scan, sql, *ACTIVE_STATES, before)
        for scan in found:
            # The results may be in place already. Without the final row they do not count.
            if self._folder.results(scan.id).exists():
                shutil.rmtree(self._folder.results(scan.id))
            detail = f"the service ended while this scan was under way; {KEPT}"
            self.end(scan.id, "interrupted", Failure("interrupted", detail))
            with scan_log_context(scan.id):
                log.warning("scan %s is interrupted: it was %s; %s", scan.id, scan.state, detail)


def _select_scans(matching: ScanFilter, before: str | None, limit: int) -> tuple[str, list[Any]]:
    """Return the SQL for the newest matching scans, and the values of its placeholders.

    Args:
        matching: Conditions.
        before: Only scans that are older than this id; None for no limit.
        limit: Maximum number of scans.
    """
    after, until = matching.created_after, matching.created_before
    candidates: list[tuple[str, Any]] = [
        ("id < ?", before),
        ("mode = ?", matching.mode),
        ("recording = ?", matching.recording),
        ("source = ?", matching.source),
        ("kept = ?", matching.kept),
        ("created_at > ?", None if after is None else format_utc(after)),
        # Times are cut to the millisecond, so the limit is rounded up.
        ("created_at < ?", None if until is None else format_utc(until, up=True)),
    ]
    conditions = [condition for condition, value in candidates if value is not None]
    values = [value for _, value in candidates if value is not None]
    if matching.states:
        conditions.append(f"state IN ({', '.join('?' * len(matching.states))})")
        values += matching.states
    where = f"WHERE {' AND '.join(conditions)} " if conditions else ""
    return f"SELECT * FROM scans {where}ORDER BY id DESC LIMIT ?", [*values, limit]
