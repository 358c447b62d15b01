"""Mends what the doctor finds, as far as it can be.

Rows are corrected, and what holds data is put aside, never removed. No service may run: this takes its lock.
"""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from cell.control.scan_loop import missing_view
from cell.recording.errors import RecordingError
from service.errors import Failure
from service.integrity.check import Examination, Examined, examine
from service.integrity.database_check import text_or_bytes
from service.integrity.finding import Code, Finding
from service.integrity.lost_and_found import LostAndFound
from service.integrity.recording_check import hash_file
from service.integrity.row_repair import mended_row
from service.integrity.salvage import salvage
from service.processing.upload_sandbox import describe_foreign_recording
from service.security.auth.tokens import FILE
from service.storage.data_folder import ID, DataFolder
from service.storage.database import now
from service.storage.rows import RecordingRow, insert, stored
from service.storage.store import KEPT, Store

ROUNDS = 5
"""Mending one thing may show another, as a file whose row was put aside."""

_NOT_OURS = {"database-newer", "database-locked", "database-unopened"}
"""Findings with which nothing may be changed."""

UNFINISHED = "the service ended while it was under way"
DAMAGED = "its result was damaged or lost; whatever was left of it is in lost+found: do it again"


def repair(store: Examined, say: Callable[[str], None]) -> Examination:
    """Mends what can be, telling each thing, and looks again; what is found then is what is left.

    Raises:
        DataFolderError: a service runs, or the folder cannot be written.
        OSError, sqlite3.Error: the disk is full, say; what was done by then is well.
    """
    with closing(DataFolder(store.root, keep_incoming=True)) as folder:
        lost = LostAndFound(store.root)
        found = examine(store, running=False)
        for _ in range(ROUNDS):
            todo = [finding for finding in found.findings if finding.repairable]
            if not todo or not _NOT_OURS.isdisjoint(finding.code for finding in found.findings):
                break
            _mend_all(store, folder, lost, todo, say)
            found = examine(store, running=False)
        return found


def _mend_all(
    store: Examined, folder: DataFolder, lost: LostAndFound, todo: list[Finding], say: Callable[[str], None]
) -> None:
    """Mends one round's findings; where the database is one of them, that alone and what needs no rows."""
    codes = {finding.code for finding in todo}
    if "database-corrupt" in codes:
        for table in salvage(store.database, lost):
            cut = ", and there is a place that cannot be read" if table.cut else ""
            say(f"{table.table}: {table.saved} rows saved, {table.refused} refused{cut}")
        say(f"the damaged database is in {lost.folder}")
    opened = Store(folder)  # makes tables that are missing, or brings them up to date
    try:
        if codes & {"database-missing", "database-older"}:
            say(f"{store.database.name} has the tables of this software now")
        mending = _Mending(store, folder, opened, lost)
        # Last: what a row belongs to may be taken in again.
        for finding in sorted(todo, key=lambda finding: finding.code == "row-without-parent"):
            if not finding.code.startswith("database-"):
                say(f"{finding.where}: {mending.mend(finding)}")
    finally:
        opened.close()


class _Mending:
    """One store under repair; each method mends what one finding is of, and says what it did."""

    def __init__(self, examined: Examined, folder: DataFolder, store: Store, lost: LostAndFound) -> None:
        self._examined, self._folder, self._store, self._lost = examined, folder, store, lost

    def mend(self, finding: Finding) -> str:
        """What was done, in words."""
        mend: dict[Code, Callable[[str], str]] = {
            "leftover": lambda name: self._aside(self._examined.root / "incoming" / name),
            "row-unreadable": self._unreadable_row,
            "row-without-parent": self._orphan_row,
            "scan-unfinished": self._unfinished_scan,
            "recording-missing": self._recording_without_file,
            "recording-changed": self._changed_recording,
            "recording-without-row": self._recording_without_row,
            "view-lost": self._lost_view,
            "result-missing": self._damaged_result,
            "result-changed": self._damaged_result,
            "result-without-row": lambda name: self._aside(self._examined.root / "scans" / name),
            "calibration-unfinished": self._unfinished_calibration,
            "calibration-missing": self._calibration_without_file,
            "calibration-without-row": lambda name: self._aside(self._examined.runs / name),
            "tokens-open": self._close_tokens,
        }
        return mend[finding.code](finding.key)

    # Files

    def _aside(self, path: Path, why: str = "nothing tells of it") -> str:
        if not (path.exists() or path.is_symlink()):
            return "it is gone"
        return f"put aside as {self._lost.move(path, why)}"

    def _close_tokens(self, _: str) -> str:
        (self._examined.root / FILE).chmod(0o600)
        return "only its owner may read it now"

    # Rows

    @contextmanager
    def _changing(self) -> Iterator[sqlite3.Connection]:
        """One change of the database. A row may be parted from those that belong to it: they are found next."""
        with closing(sqlite3.connect(self._folder.database, isolation_level=None)) as db:
            db.row_factory = sqlite3.Row
            db.text_factory = text_or_bytes
            db.execute("PRAGMA synchronous = FULL")
            db.execute("BEGIN IMMEDIATE")
            yield db  # closed without a commit, nothing was done
            db.execute("COMMIT")

    def _row_aside(self, key: str, why: str = "it cannot be read") -> str:
        table, _, rowid = key.partition("/")
        with self._changing() as db:
            row = db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (int(rowid),)).fetchone()
            if row is None:
                return "it is gone"
            self._lost.keep_row(table, dict(row), why)
            db.execute(f"DELETE FROM {table} WHERE rowid = ?", (int(rowid),))
        return f"the row is in {self._lost.folder / 'rows.jsonl'} now"

    def _unreadable_row(self, key: str) -> str:
        table, _, rowid = key.partition("/")
        with self._changing() as db:
            row = db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (int(rowid),)).fetchone()
            if row is None:
                return "it is gone"
            mended = mended_row(db, table, dict(row))
            if mended:
                self._lost.keep_row(table, dict(row), "the service could not tell it; it was corrected")
                columns = ", ".join(f"{name} = ?" for name in mended)
                db.execute(f"UPDATE {table} SET {columns} WHERE rowid = ?", (*mended.values(), int(rowid)))
        if mended is None:
            return self._row_aside(key)
        state = f"it is {mended['state']}" if "state" in mended else "it can be read"
        return f"{state} now; the row as it was is in {self._lost.folder / 'rows.jsonl'}"

    def _orphan_row(self, key: str) -> str:
        table, _, rowid = key.partition("/")
        if table != "scans":
            return self._row_aside(key, "what it belongs to is not there")
        gone = "rowid = ? AND recording NOT IN (SELECT id FROM recordings)"
        with self._changing() as db:
            done = db.execute(f"UPDATE scans SET recording = NULL WHERE {gone}", (int(rowid),)).rowcount
        return "it has no recording any more" if done else "its recording is there"

    def _unfinished_scan(self, scan_id: str) -> str:
        self._store.end_scan(scan_id, "interrupted", Failure("interrupted", f"{UNFINISHED}; {KEPT}"))
        return "it is interrupted"

    def _unfinished_calibration(self, run_id: str) -> str:
        self._store.calibrations.end(run_id, "interrupted", Failure("interrupted", UNFINISHED))
        return "it is interrupted"

    def _fail(self, table: str, row_id: str, **values: Any) -> None:
        failure = stored(Failure("damaged", DAMAGED))
        with self._changing() as db:
            for name, value in {"state": "failed", "failure": failure, **values}.items():
                db.execute(f"UPDATE {table} SET {name} = ? WHERE id = ?", (value, row_id))

    def _damaged_result(self, scan_id: str) -> str:
        done = self._aside(self._folder.root / "scans" / scan_id, "its content is not as it was written")
        self._fail("scans", scan_id, summary=None, files=None)
        return f"{done}; the scan is failed, and can be reprocessed where it has its recording"

    def _calibration_without_file(self, run_id: str) -> str:
        self._fail("calibrations", run_id)
        return "the calibration is failed"

    # Recordings

    def _recording_without_file(self, recording_id: str) -> str:
        with self._changing() as db:
            row = db.execute("SELECT * FROM recordings WHERE id = ?", (recording_id,)).fetchone()
            if row is not None:
                self._lost.keep_row("recordings", dict(row), "its file cannot be used")
                db.execute("UPDATE scans SET recording = NULL WHERE recording = ?", (recording_id,))
                db.execute("DELETE FROM recordings WHERE id = ?", (recording_id,))
        return f"its row is in {self._lost.folder / 'rows.jsonl'} now; its scans have no recording"

    def _changed_recording(self, recording_id: str) -> str:
        path = self._examined.root / "recordings" / f"{recording_id}.mcap"
        try:
            row = self._described(recording_id, path)
        except (RecordingError, OSError) as error:
            return f"{self._aside(path, str(error))}: {error}; {self._recording_without_file(recording_id)}"
        with self._changing() as db:
            for name in ("size_bytes", "sha256", "views", "missing"):
                value = stored(getattr(row, name))
                db.execute(f"UPDATE recordings SET {name} = ? WHERE id = ?", (value, recording_id))
        return f"its row tells what is there now: {row.views} views"

    def _recording_without_row(self, name: str) -> str:
        path = self._examined.root / "recordings" / name
        if path.suffix != ".mcap" or not ID.fullmatch(path.stem) or path.is_symlink() or not path.is_file():
            return self._aside(path)
        try:
            row = self._described(path.stem, path)
        except (RecordingError, OSError) as error:
            return f"{self._aside(path, str(error))}: {error}"
        scan = self._store.scan(row.id)
        if scan is not None and scan.mode == "live":
            self._store.add_scan_recording(row)
        else:
            with self._store.database.transaction() as db:
                insert(db, "recordings", row)
        return f"taken in as a recording of {row.views} views"

    def _lost_view(self, key: str) -> str:
        scan_id, _, view = key.partition("/")
        reason = "it was on the disk, and is no longer as it was written"
        with self._changing() as db:
            db.execute(
                "UPDATE views SET state = 'missing', reason = ?, changed_at = ? WHERE scan = ? AND view = ?",
                (reason, now(), scan_id, int(view)),
            )
        return f"view {view} is missing by its row"

    def _described(self, recording_id: str, path: Path) -> RecordingRow:
        """The row that the file deserves. It may be a stranger's. Raises RecordingError, OSError."""
        row = describe_foreign_recording(recording_id, path, hash_file(path).sha256)
        gone = [view for view in self._store.views([recording_id]) if view.state == "missing"]
        return replace(row, missing=[*(missing_view(view.view, view.reason or "") for view in gone), *row.missing])
