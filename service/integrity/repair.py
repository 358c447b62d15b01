"""Repair of what the integrity check finds, as far as possible.

The repair first copies the database to `lost+found`; then it changes rows. No file that holds data is deleted: it is
moved to `lost+found`. The repair takes the lock of the service, so no service may run.
"""

import reprlib
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from cell.control.progress import MissingView
from cell.recording.errors import RecordingError
from service.clock import format_utc
from service.errors import Failure
from service.integrity.check import CheckReport, CheckTarget, check_store
from service.integrity.database_check import text_or_bytes
from service.integrity.database_recovery import recover_database
from service.integrity.finding import Code, Finding
from service.integrity.lost_and_found import LostAndFound
from service.integrity.recording_check import hash_file
from service.integrity.row_repair import rebuild_row
from service.processing.upload_sandbox import describe_untrusted_recording
from service.storage.data_folder import ID, PREVIEW, DataFolder
from service.storage.database import now, time_of_id
from service.storage.rows import RecordingRow, insert, stored
from service.storage.scan_store import KEPT
from service.storage.store import Store

MAX_ROUNDS = 5
"""Limit on repetitions of check and repair. One repair may cause another finding, such as a file without its row."""

_BLOCKING_CODES = {"database-newer", "database-unknown", "database-locked", "database-inaccessible"}
"""Findings that block every repair."""

UNFINISHED = "the service ended while it was under way"
DAMAGED = "its result was damaged or lost; what was left of it is in lost+found: run it again"


def repair(store: CheckTarget, report: Callable[[str], None]) -> CheckReport:
    """Repair what can be repaired, then check again.

    Args:
        store: The data folder.
        report: Called with a message after each repair.

    Returns:
        The last check: its findings could not be repaired.

    Raises:
        DataFolderError: A service runs, or the folder cannot be written.
        OSError: The disk failed, for example because it is full. The finished repairs stay valid.
        sqlite3.Error: As for OSError.
    """
    with closing(DataFolder(store.root, keep_incoming=True)) as folder:
        lost = LostAndFound(store.root)
        found = check_store(store, running=False)
        for number in range(MAX_ROUNDS):
            todo = [finding for finding in found.findings if finding.repairable]
            if not todo or not _BLOCKING_CODES.isdisjoint(finding.code for finding in found.findings):
                break
            if number == 0:
                _copy_database(store.database, lost)
            _repair_all(store, folder, lost, todo, report)
            found = check_store(store, running=False)
        return found


def _copy_database(database: Path, lost: LostAndFound) -> None:
    for suffix in ("", "-wal"):
        if (path := Path(f"{database}{suffix}")).exists():
            lost.copy(path, "the database before the repair")


def _repair_all(
    store: CheckTarget, folder: DataFolder, lost: LostAndFound, todo: list[Finding], report: Callable[[str], None]
) -> None:
    """Repair the findings of one round, the database first. Beside a damaged database, no finding needs a row."""
    codes = {finding.code for finding in todo}
    if "database-corrupt" in codes:
        for message in recover_database(store.database, lost.folder / store.database.name):
            report(message)
        report(f"the damaged database is in {lost.folder}")
    opened = Store(folder)  # creates missing tables and migrates older ones
    try:
        if codes & {"database-missing", "database-older"}:
            report(f"{store.database.name} now has the tables of this release")
        repairer = _Repairer(store, folder, opened, lost)
        # rows without a parent come last, because the parent may be adopted again before
        for finding in sorted(todo, key=lambda finding: finding.code == "row-without-parent"):
            if not finding.code.startswith("database-"):
                report(f"{finding.where}: {repairer.repair(finding)}")
    finally:
        opened.close()


class _Repairer:
    """The repairs of one data folder. Each method repairs one kind of finding and returns a message."""

    def __init__(self, target: CheckTarget, folder: DataFolder, store: Store, lost: LostAndFound) -> None:
        self._target, self._folder, self._store, self._lost = target, folder, store, lost
        self._original = f"the row before the repair is in {lost.folder / target.database.name}"

    def repair(self, finding: Finding) -> str:
        """Repair a finding and return what was done, as a message."""
        repairs: dict[Code, Callable[[str], str]] = {
            "leftover": lambda name: self._move_aside(self._target.root / "incoming" / name),
            "row-unreadable": self._unreadable_row,
            "row-without-parent": self._orphan_row,
            "scan-unfinished": self._unfinished_scan,
            "recording-missing": self._recording_without_file,
            "recording-changed": self._changed_recording,
            "recording-without-row": self._recording_without_row,
            "view-lost": self._lost_view,
            "result-missing": self._damaged_result,
            "result-changed": self._damaged_result,
            "picture-changed": self._damaged_picture,
            "result-without-row": lambda name: self._move_aside(self._target.root / "scans" / name),
            "calibration-unfinished": self._unfinished_calibration,
            "calibration-missing": self._calibration_without_file,
            "calibration-without-row": lambda name: self._move_aside(self._target.runs / name),
            "tokens-open": self._restrict_tokens,
        }
        return repairs[finding.code](finding.key)

    # Files

    def _move_aside(self, path: Path, why: str = "no database row refers to it") -> str:
        if not (path.exists() or path.is_symlink()):
            return "it no longer exists"
        return f"moved to {self._lost.move(path, why)}"

    def _restrict_tokens(self, name: str) -> str:
        (self._target.root / name).chmod(0o600)
        return "now only its owner may read it"

    # Rows

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Open one transaction without foreign keys. Rows that lose their parent are found in the next round."""
        with closing(sqlite3.connect(self._folder.database, isolation_level=None)) as db:
            db.row_factory = sqlite3.Row
            db.text_factory = text_or_bytes
            db.execute("PRAGMA synchronous = FULL")
            db.execute("BEGIN IMMEDIATE")
            yield db  # after an exception the connection is closed without a commit
            db.execute("COMMIT")

    def _remove_row(self, key: str) -> str:
        table, _, rowid = key.partition("/")
        with self._transaction() as db:
            rows = db.execute(f"DELETE FROM {table} WHERE rowid = ? RETURNING *", (int(rowid),)).fetchall()
        return f"removed: {_describe(dict(rows[0]))}; {self._original}" if rows else "it no longer exists"

    def _unreadable_row(self, key: str) -> str:
        table, _, rowid = key.partition("/")
        with self._transaction() as db:
            row = db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (int(rowid),)).fetchone()
            if row is not None and (rebuilt := rebuild_row(db, table, dict(row))) is not None:
                changed = {name: value for name, value in rebuilt.items() if value != row[name]}
                for name, value in changed.items():
                    db.execute(f"UPDATE {table} SET {name} = ? WHERE rowid = ?", (value, int(rowid)))
                return f"now {_describe(changed)}; {self._original}"
        return self._remove_row(key)

    def _orphan_row(self, key: str) -> str:
        table, _, rowid = key.partition("/")
        if table != "scans":
            return self._remove_row(key)
        without_recording = "rowid = ? AND recording NOT IN (SELECT id FROM recordings)"
        with self._transaction() as db:
            changed = db.execute(f"UPDATE scans SET recording = NULL WHERE {without_recording}", (int(rowid),)).rowcount
        return "it has no recording any more" if changed else "its recording exists"

    def _unfinished_scan(self, scan_id: str) -> str:
        self._store.scans.end(scan_id, "interrupted", Failure("interrupted", f"{UNFINISHED}; {KEPT}"))
        return "it is now interrupted"

    def _unfinished_calibration(self, run_id: str) -> str:
        self._store.calibrations.end(run_id, "interrupted", Failure("interrupted", UNFINISHED))
        return "it is now interrupted"

    def _fail(self, table: str, row_id: str, **values: Any) -> None:
        failure = stored(Failure("damaged", DAMAGED))
        with self._transaction() as db:
            for name, value in {"state": "failed", "failure": failure, **values}.items():
                db.execute(f"UPDATE {table} SET {name} = ? WHERE id = ?", (value, row_id))

    def _damaged_result(self, scan_id: str) -> str:
        done = self._move_aside(self._folder.root / "scans" / scan_id, "its content is not as it was written")
        self._fail("scans", scan_id, summary=None, files=None)
        return f"{done}; the scan is now failed, and can be reprocessed if it has its recording"

    def _damaged_picture(self, scan_id: str) -> str:
        done = self._move_aside(self._folder.root / "scans" / scan_id / PREVIEW, "it is not as it was written")
        sql = "UPDATE scans SET files = json_remove(files, '$.\"' || ? || '\"') WHERE id = ?"
        with self._transaction() as db:
            db.execute(sql, (PREVIEW, scan_id))
        return f"{done}; the result has no picture any more"

    def _calibration_without_file(self, run_id: str) -> str:
        self._fail("calibrations", run_id)
        return "the calibration is now failed"

    # Recordings

    def _recording_without_file(self, recording_id: str) -> str:
        with self._transaction() as db:
            db.execute("UPDATE scans SET recording = NULL WHERE recording = ?", (recording_id,))
            db.execute("DELETE FROM recordings WHERE id = ?", (recording_id,))
        return f"its row was removed, and its scans have no recording; {self._original}"

    def _changed_recording(self, recording_id: str) -> str:
        path = self._target.root / "recordings" / f"{recording_id}.mcap"
        try:
            row = self._describe_recording(recording_id, path)
        except (RecordingError, OSError) as error:
            return f"{self._move_aside(path, str(error))}: {error}; {self._recording_without_file(recording_id)}"
        with self._transaction() as db:
            for name in ("size_bytes", "sha256", "views", "missing"):
                value = stored(getattr(row, name))
                db.execute(f"UPDATE recordings SET {name} = ? WHERE id = ?", (value, recording_id))
        return f"its row now describes the file: {row.views} views"

    def _recording_without_row(self, name: str) -> str:
        path = self._target.root / "recordings" / name
        if path.suffix != ".mcap" or not ID.fullmatch(path.stem) or path.is_symlink() or not path.is_file():
            return self._move_aside(path)
        try:
            row = self._describe_recording(path.stem, path)
        except (RecordingError, OSError) as error:
            return f"{self._move_aside(path, str(error))}: {error}"
        scan = self._store.scans.get(row.id)
        if scan is not None and scan.mode == "live":
            self._store.add_scan_recording(row)
        else:
            if (uploaded := time_of_id(row.id)) is not None:
                row = replace(row, created_at=format_utc(uploaded))
            with self._store.database.transaction() as db:
                insert(db, "recordings", row)
        return f"adopted as a recording of {row.views} views"

    def _lost_view(self, key: str) -> str:
        scan_id, _, view = key.partition("/")
        reason = "the view was recorded, but its bytes in the file have changed or are lost"
        with self._transaction() as db:
            db.execute(
                "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND view = ?",
                (reason, now(), scan_id, int(view)),
            )
        return f"view {view} is now missing by its row"

    def _describe_recording(self, recording_id: str, path: Path) -> RecordingRow:
        """Return the row that describes a file, which may come from a foreign source.

        Raises:
            RecordingError: The file is not a recording.
            OSError: The file cannot be read.
        """
        row = describe_untrusted_recording(recording_id, path, hash_file(path).sha256)
        missing = [view for view in self._store.scans.views([recording_id]) if view.state == "missing"]
        messages = [MissingView(view.view, view.reason or "").message for view in missing]
        return replace(row, missing=[*messages, *row.missing])


def _describe(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {reprlib.repr(value)}" for name, value in values.items())
