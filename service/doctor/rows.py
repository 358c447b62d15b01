"""The database as the doctor reads it: without changing it, and without trusting any row."""

import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.data_folder import ID
from service.doctor.finding import REPAIR, Finding
from service.tables import (
    VERSION,
    CalibrationRow,
    RecordingRow,
    ScanRow,
    ViewRow,
    to_calibration,
    to_recording,
    to_scan,
)

TABLES = (
    "recordings", "scans", "views", "calibrations", "calibration_views", "scan_errors", "idempotency_keys", "events",
    "cell_fault", "audit",
)  # fmt: skip
"""Those of the present version, parents before children."""
MOST_TOLD = 20


@dataclass
class Rows:
    """What the doctor compares with the files."""

    recordings: dict[str, RecordingRow] = field(default_factory=dict)
    scans: dict[str, ScanRow] = field(default_factory=dict)
    views: dict[str, list[ViewRow]] = field(default_factory=lambda: defaultdict(list))
    """By scan."""
    calibrations: dict[str, CalibrationRow] = field(default_factory=dict)


@contextmanager
def read_only(database: Path) -> Iterator[sqlite3.Connection]:
    """A connection that changes nothing. Raises sqlite3.Error."""
    with closing(sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)) as db:
        db.isolation_level = None
        db.row_factory = sqlite3.Row
        yield db


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
        if getattr(error, "sqlite_errorcode", None) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            what = "another program holds the database"
            return [Finding("database", "database-locked", where, what, "try again in some seconds", False)], None
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


def _rows(db: sqlite3.Connection) -> tuple[Rows, list[Finding]]:
    rows, found = Rows(), []

    def of(table: str, make: Callable[[Any], Any], keep: Callable[[Any], None]) -> None:
        for row in db.execute(f"SELECT rowid AS doctor_rowid, * FROM {table}"):
            values = dict(row)
            rowid = values.pop("doctor_rowid")
            try:
                made = make(values)  # by its columns' names, as of a sqlite3.Row
                require_id(made)
            except (ValueError, TypeError) as error:
                what = f"it cannot be read: {error}"
                key = f"{table}/{rowid}"
                advice = f"{REPAIR}: it is put aside"
                found.append(Finding("database", "row-unreadable", f"{table}, row {rowid}", what, advice, True, key))
            else:
                keep(made)

    of("recordings", to_recording, lambda row: rows.recordings.update({row.id: row}))
    of("scans", to_scan, lambda row: rows.scans.update({row.id: row}))
    of("views", lambda values: ViewRow(**values), lambda row: rows.views[row.scan].append(row))
    of("calibrations", to_calibration, lambda row: rows.calibrations.update({row.id: row}))
    return rows, found


def require_id(row: RecordingRow | ScanRow | ViewRow | CalibrationRow) -> None:
    """Raises ValueError: the row's id is none of ours, so that nothing may be looked for by it."""
    row_id = row.scan if isinstance(row, ViewRow) else row.id
    if not isinstance(row_id, str) or not ID.fullmatch(row_id):
        raise ValueError(f"{row_id!r} is not an id")


def _orphans(db: sqlite3.Connection) -> list[Finding]:
    found = []
    for table, rowid, parent, _ in db.execute("PRAGMA foreign_key_check").fetchall():
        what = f"it belongs to a row of {parent} that is not there"
        where, key = f"{table}, row {rowid}", f"{table}/{rowid}"
        found.append(Finding("database", "row-without-parent", where, what, REPAIR, True, key))
    return found
