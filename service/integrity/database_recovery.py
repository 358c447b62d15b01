"""Recovery of a damaged database: every row that can still be read is copied into a new database.

Recordings and results alone would not do: they know no events, idempotency keys, audit entries, calibrations or marks.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from service.integrity.database_check import TABLES, read_only
from service.storage.migrations import latest_version, migrate

MAX_ROWID = 2**63 - 1
"""Largest row id of SQLite."""
MAX_GAP_ROWS = 100_000
"""Limit on the row ids that are tried, one by one, to get past an unreadable part of a table."""


def recover_database(database: Path, copy: Path) -> list[str]:
    """Replace a damaged database by a new one with all readable rows. No other process may have it open.

    Args:
        database: File of the database.
        copy: Complete copy of it, from which the rows are read.

    Returns:
        A message for each table.

    Raises:
        OSError: A file cannot be written, for example for lack of space. The database is then unchanged.
    """
    fresh = database.with_name(f".{database.name}.new")
    for suffix in ("", "-wal", "-shm"):
        Path(f"{fresh}{suffix}").unlink(missing_ok=True)  # left by a repair that was killed
    with closing(sqlite3.connect(fresh, isolation_level=None)) as new:  # without a log: one file is moved
        new.execute("PRAGMA synchronous = FULL")
        new.execute("BEGIN")
        migrate(new, _version(copy))
        messages = [_copy_table(copy, new, table) for table in TABLES]
        migrate(new)
        new.execute("COMMIT")
    # from here on only the copy holds the old database; its log goes first, so that the new one never uses it
    for suffix in ("-shm", "-wal"):
        Path(f"{database}{suffix}").unlink(missing_ok=True)
    fresh.replace(database)
    sync_folder(database.parent)
    return messages


def _version(copy: Path) -> int:
    """Return the version of the tables, whose columns the rows have; the latest if it cannot be read."""
    try:
        with read_only(copy) as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
    except sqlite3.DatabaseError:
        return latest_version()
    return version if 0 < version <= latest_version() else latest_version()


def _copy_table(copy: Path, new: sqlite3.Connection, table: str) -> str:
    columns = [row[1] for row in new.execute(f"PRAGMA table_info({table})")]
    recovered = rejected = 0
    errors: set[str] = set()
    for values in _readable_rows(copy, table, errors):
        known = {name: value for name, value in values.items() if name in columns}
        sql = f"INSERT INTO {table} ({', '.join(known)}) VALUES ({', '.join('?' * len(known))})"
        try:
            new.execute(sql, list(known.values()))
            recovered += 1
        except sqlite3.IntegrityError:  # it violates a constraint of the table
            rejected += 1
    part = ", and a part of the table cannot be read" if errors else ""
    return f"{table}: {recovered} rows recovered, {rejected} rejected{part}"


def _readable_rows(copy: Path, table: str, errors: set[str]) -> Iterator[dict[str, Any]]:
    """Yield each readable row, and add the errors of reading to `errors`.

    Reads upwards. After an error, the next row ids are tried. If none can be read, reads downwards from the last row.
    """
    with read_only(copy) as db:  # must not change the copy
        low = failed = 0
        try:
            db.execute(f"SELECT 1 FROM {table} LIMIT 0")
        except sqlite3.DatabaseError as error:  # the list of tables cannot be read
            errors.add(str(error))
            return
        while failed <= MAX_GAP_ROWS:
            try:
                row = _read_row(db, table, ">= ? ORDER BY rowid", low)
            except sqlite3.DatabaseError as error:
                errors.add(str(error))
                low, failed = low + 1, failed + 1
                continue
            if row is None:
                return
            yield dict(row)
            low, failed = max(low, row["checked_rowid"]) + 1, 0
        high = MAX_ROWID
        with suppress(sqlite3.DatabaseError):
            while row := _read_row(db, table, "BETWEEN ? AND ? ORDER BY rowid DESC", low, high):
                yield dict(row)
                high = min(high, row["checked_rowid"]) - 1


def _read_row(db: sqlite3.Connection, table: str, condition: str, *rowids: int) -> sqlite3.Row | None:
    """Read one row. A statement for many rows would lose the last one before an error."""
    sql = f"SELECT rowid AS checked_rowid, * FROM {table} WHERE rowid {condition} LIMIT 1"
    return db.execute(sql, rowids).fetchone()
