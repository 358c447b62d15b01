"""Check of the database, which is opened read-only. No row is trusted."""

import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.integrity.finding import REPAIR, Finding
from service.integrity.row_decoding import UnreadableRowError, decode_row
from service.storage.migrations import has_unknown_layout, latest_version
from service.storage.rows import CalibrationRow, RecordingRow, Row, ScanRow, ViewRow
from service.storage.storage_errors import is_locked

TABLES = (
    "recordings", "scans", "views", "calibrations", "calibration_views", "scan_errors", "idempotency_keys", "events",
    "cell_fault", "audit",
)  # fmt: skip
"""Tables of the current version, parents before children."""
DECODED_TABLES = TABLES[:5]
"""Tables whose rows the service returns."""
LOCKED_ADVICE = "try again in a few seconds; if the service has started on a full disk, restart it when there is space"
MAX_REPORTED = 20
"""Limit on the damages that SQLite lists, and on the findings of a group that are printed."""

_ENVIRONMENT_ERRORS = {
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL,
}  # fmt: skip
"""Primary codes of errors that come from permissions or the disk. They say nothing about the content."""


@dataclass
class Rows:
    """Rows of the database that are compared with the files."""

    recordings: dict[str, RecordingRow] = field(default_factory=dict)
    scans: dict[str, ScanRow] = field(default_factory=dict)
    views: dict[str, list[ViewRow]] = field(default_factory=lambda: defaultdict(list))
    """Views by the id of their scan."""
    calibrations: dict[str, CalibrationRow] = field(default_factory=dict)
    unreadable: dict[str, set[object]] = field(default_factory=lambda: defaultdict(set))
    """Ids of unreadable rows, by table. What belongs to such a row is not without a row."""

    def parent(self, values: dict[str, Any]) -> Row | None:
        """Return the scan or calibration that a row belongs to; None if it cannot be read or there is none."""
        return self.scans.get(values.get("scan", "")) or self.calibrations.get(values.get("calibration", ""))

    def add(self, row: Row) -> None:
        """Add a row. No file belongs to the views of a calibration, so they are not kept."""
        match row:
            case RecordingRow():
                self.recordings[row.id] = row
            case ScanRow():
                self.scans[row.id] = row
            case ViewRow():
                self.views[row.scan].append(row)
            case CalibrationRow():
                self.calibrations[row.id] = row


@contextmanager
def read_only(database: Path) -> Iterator[sqlite3.Connection]:
    """Open a connection that changes nothing.

    Raises:
        sqlite3.Error: The database cannot be opened.
    """
    with closing(sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)) as db:
        db.isolation_level = None
        db.row_factory = sqlite3.Row
        db.text_factory = text_or_bytes
        yield db


def text_or_bytes(value: bytes) -> str | bytes:
    """Decode the text of a column, or return its bytes, so that the other columns and rows can still be read."""
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value


def check_database(database: Path, quick: bool) -> tuple[list[Finding], Rows | None]:
    """Check the database and read its rows.

    Args:
        database: File of the database.
        quick: Skip the slower checks of SQLite.

    Returns:
        The findings, and the rows. None instead of the rows: they cannot be read before a repair.
    """
    where = str(database)
    try:
        with read_only(database) as db:
            found = _damage(db, where, quick) or _version(db, where) or _tables(db, where)
            if found:
                return found, None
            db.execute("BEGIN")  # reads all rows from one snapshot
            rows, unreadable = _rows(db)
            return [*unreadable, *_orphans(db)], rows
    except sqlite3.DatabaseError as error:
        if is_locked(error):
            what = "another program has locked the database"
            return [Finding("database", "database-locked", where, what, LOCKED_ADVICE, False)], None
        if getattr(error, "sqlite_errorcode", 0) & 0xFF in _ENVIRONMENT_ERRORS:  # the low byte is the primary code
            return [_inaccessible(where, error)], None
        return [_corrupt(where, str(error))], None


def _damage(db: sqlite3.Connection, where: str, quick: bool) -> list[Finding]:
    answers = [row[0] for row in db.execute(f"PRAGMA {'quick_check' if quick else 'integrity_check'}({MAX_REPORTED})")]
    return [] if answers == ["ok"] else [_corrupt(where, "; ".join(answers[:3]))]


def _version(db: sqlite3.Connection, where: str) -> list[Finding]:
    if has_unknown_layout(db):
        what = "it has tables that no release of Pointchain made"
        return [Finding("database", "database-unknown", where, what, "use another data_dir", False)]
    latest = latest_version()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version > latest:
        what = f"its tables have version {version}; this release knows version {latest}"
        return [Finding("database", "database-newer", where, what, "use a later release, or another data_dir", False)]
    if version < latest:
        what = f"its tables have version {version}; this release uses {latest}. The rows were not checked"
        return [Finding("database", "database-older", where, what, f"start the service once, or {REPAIR}", True)]
    return []


def _tables(db: sqlite3.Connection, where: str) -> list[Finding]:
    existing = {row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    missing = [name for name in TABLES if name not in existing]
    return [_corrupt(where, f"it has no table {', '.join(missing)}")] if missing else []


def _corrupt(where: str, what: str) -> Finding:
    advice = f"{REPAIR}: it is copied to lost+found, and readable rows are recovered into a new database"
    return Finding("database", "database-corrupt", where, f"it is damaged: {what}", advice, True)


def _inaccessible(where: str, error: sqlite3.Error) -> Finding:
    what = f"this user cannot open it, so its content was not checked: {error} ({error.sqlite_errorname})"
    advice = (
        "make sure that this user may read and write the data folder and everything in it, and that its disk works, "
        "has space and is not mounted read-only (SQLite needs to create files beside the database); then check again"
    )
    return Finding("database", "database-inaccessible", where, what, advice, False)


def _rows(db: sqlite3.Connection) -> tuple[Rows, list[Finding]]:
    rows, found = Rows(), []
    for table in DECODED_TABLES:
        for row in db.execute(f"SELECT rowid AS checked_rowid, * FROM {table}"):
            values = dict(row)
            rowid = values.pop("checked_rowid")
            try:
                rows.add(decode_row(table, values, rows.parent(values)))
            except UnreadableRowError as error:
                rows.unreadable[table].add(values.get("id"))
                what = f"the service cannot return it, nor a list that contains it: {error}"
                key = f"{table}/{rowid}"
                advice = f"{REPAIR}: it is rebuilt from what is known if possible, else removed"
                found.append(Finding("database", "row-unreadable", f"{table}, row {rowid}", what, advice, True, key))
    return rows, found


def _orphans(db: sqlite3.Connection) -> list[Finding]:
    found = []
    for table, rowid, parent, _ in db.execute("PRAGMA foreign_key_check").fetchall():
        what = f"it belongs to a row of {parent} that does not exist"
        where, key = f"{table}, row {rowid}", f"{table}/{rowid}"
        found.append(Finding("database", "row-without-parent", where, what, REPAIR, True, key))
    return found
