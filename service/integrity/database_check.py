"""The database as the doctor reads it: without changing it, and without trusting any row."""

import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.integrity.finding import REPAIR, Finding
from service.integrity.row_decoding import (
    UnreadableRowError,
    readable_calibration,
    readable_calibration_view,
    readable_recording,
    readable_scan,
    readable_view,
)
from service.storage.migrations import VERSION
from service.storage.rows import CalibrationRow, RecordingRow, ScanRow, ViewRow
from service.storage.storage_errors import is_held

TABLES = (
    "recordings", "scans", "views", "calibrations", "calibration_views", "scan_errors", "idempotency_keys", "events",
    "cell_fault", "audit",
)  # fmt: skip
"""Those of the present version, parents before children."""
MOST_TOLD = 20

_NOT_THE_DATABASE = {
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL,
}  # fmt: skip
"""Primary codes of errors that tell of rights or of the disk, and nothing of what is in the database."""


@dataclass
class Rows:
    """What the doctor compares with the files."""

    recordings: dict[str, RecordingRow] = field(default_factory=dict)
    scans: dict[str, ScanRow] = field(default_factory=dict)
    views: dict[str, list[ViewRow]] = field(default_factory=lambda: defaultdict(list))
    """By scan."""
    calibrations: dict[str, CalibrationRow] = field(default_factory=dict)
    unreadable: dict[str, set[object]] = field(default_factory=lambda: defaultdict(set))
    """Ids of rows that are there but cannot be told, by table: what belongs to them does not belong to nothing."""


@contextmanager
def read_only(database: Path) -> Iterator[sqlite3.Connection]:
    """A connection that changes nothing. Raises sqlite3.Error."""
    with closing(sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)) as db:
        db.isolation_level = None
        db.row_factory = sqlite3.Row
        db.text_factory = text_or_bytes
        yield db


def text_or_bytes(value: bytes) -> str | bytes:
    """A column's text; as it is where it is none, so that the other columns and rows can be read all the same."""
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value


def check_database(database: Path, quick: bool) -> tuple[list[Finding], Rows | None]:
    """What is wrong with the database, and its rows; None where they cannot be read as they are."""
    where = str(database)
    try:
        with read_only(database) as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            found = _damage(db, where, quick) or _version(where, version) or _tables(db, where)
            if found:
                return found, None
            db.execute("BEGIN")  # all rows as they are at one moment
            rows, unreadable = _rows(db)
            return [*unreadable, *_orphans(db)], rows
    except sqlite3.DatabaseError as error:
        if is_held(error):
            what = "another program holds the database"
            return [Finding("database", "database-locked", where, what, "try again in some seconds", False)], None
        if getattr(error, "sqlite_errorcode", 0) & 0xFF in _NOT_THE_DATABASE:  # the lower byte is the primary one
            return [_unopened(where, error)], None
        return [_corrupt(where, str(error))], None


def _damage(db: sqlite3.Connection, where: str, quick: bool) -> list[Finding]:
    told = [row[0] for row in db.execute(f"PRAGMA {'quick_check' if quick else 'integrity_check'}({MOST_TOLD})")]
    return [] if told == ["ok"] else [_corrupt(where, "; ".join(told[:3]))]


def _version(where: str, version: int) -> list[Finding]:
    if version > VERSION:
        what = f"it has tables of version {version}, this software knows {VERSION}"
        return [Finding("database", "database-newer", where, what, "use a later release, or another data_dir", False)]
    if version < VERSION:
        what = f"it has tables of version {version}, this software's are of {VERSION}; their rows were not looked at"
        return [Finding("database", "database-older", where, what, f"start the service once, or {REPAIR}", True)]
    return []


def _tables(db: sqlite3.Connection, where: str) -> list[Finding]:
    there = {row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    gone = [name for name in TABLES if name not in there]
    return [_corrupt(where, f"it has no table {', '.join(gone)}")] if gone else []


def _corrupt(where: str, what: str) -> Finding:
    advice = f"{REPAIR}: the files are kept, and what can be read is saved into a new one"
    return Finding("database", "database-corrupt", where, f"it is damaged: {what}", advice, True)


def _unopened(where: str, error: sqlite3.Error) -> Finding:
    what = f"it cannot be read from here, which says nothing of its content: {error} ({error.sqlite_errorname})"
    advice = (
        "see that this user may read and write the data folder and all in it, and that its disk is well, has space and "
        "is not mounted read-only: SQLite makes files beside the database to read it; then ask again"
    )
    return Finding("database", "database-unopened", where, what, advice, False)


def _rows(db: sqlite3.Connection) -> tuple[Rows, list[Finding]]:
    rows, found = Rows(), []

    def of(table: str, make: Callable[[Any], Any], keep: Callable[[Any], None]) -> None:
        for row in db.execute(f"SELECT rowid AS doctor_rowid, * FROM {table}"):
            values = dict(row)
            rowid = values.pop("doctor_rowid")
            try:
                made = make(values)
            except UnreadableRowError as error:
                rows.unreadable[table].add(values.get("id"))
                what = f"the service cannot tell it, nor a list that it is in: {error}"
                key = f"{table}/{rowid}"
                advice = f"{REPAIR}: it is kept in lost+found, and corrected if it can be, else taken out"
                found.append(Finding("database", "row-unreadable", f"{table}, row {rowid}", what, advice, True, key))
            else:
                keep(made)

    of("recordings", readable_recording, lambda row: rows.recordings.update({row.id: row}))
    of("scans", readable_scan, lambda row: rows.scans.update({row.id: row}))
    of("views", lambda values: readable_view(values, rows.scans.get), lambda row: rows.views[row.scan].append(row))
    of("calibrations", readable_calibration, lambda row: rows.calibrations.update({row.id: row}))
    of(
        "calibration_views",
        lambda values: readable_calibration_view(values, rows.calibrations.get),
        lambda row: None,  # nothing hangs on it
    )
    return rows, found


def _orphans(db: sqlite3.Connection) -> list[Finding]:
    found = []
    for table, rowid, parent, _ in db.execute("PRAGMA foreign_key_check").fetchall():
        what = f"it belongs to a row of {parent} that is not there"
        where, key = f"{table}, row {rowid}", f"{table}/{rowid}"
        found.append(Finding("database", "row-without-parent", where, what, REPAIR, True, key))
    return found
