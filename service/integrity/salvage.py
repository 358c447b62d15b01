"""Recovery of a damaged database: every row that can still be read is copied into a new database."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from service.integrity.database_check import TABLES, read_only
from service.integrity.lost_and_found import LostAndFound
from service.storage.database import Database

MAX_GAP_ROWS = 100_000
"""Limit on the row ids that are tried one by one, between the rows readable from both ends of a table."""


@dataclass(frozen=True)
class RecoveredTable:
    """Outcome of the recovery of one table."""

    table: str
    recovered: int
    """Count of rows copied."""
    rejected: int
    """Count of rows that could be read but violate a constraint of the table."""
    has_unreadable_part: bool
    """Whether a part of the table cannot be read. Its rows may be lost."""


def recover_database(database: Path, lost: LostAndFound) -> list[RecoveredTable]:
    """Replace a damaged database by a new one with all readable rows.

    The files of the damaged database are copied to `lost` first. No other process may have it open.

    Args:
        database: File of the database.
        lost: Folder that keeps the damaged database.

    Returns:
        The outcome for each table.

    Raises:
        OSError: A file cannot be written, for example for lack of space. The database is then unchanged.
    """
    files = [path for suffix in ("", "-wal") if (path := Path(f"{database}{suffix}")).exists()]
    copies = [lost.copy(path, "the damaged database") for path in files]
    fresh = database.with_name(f".{database.name}.new")
    for suffix in ("", "-wal", "-shm"):
        Path(f"{fresh}{suffix}").unlink(missing_ok=True)  # left by a repair that was killed
    Database(fresh).close()
    tables = _copy_tables(copies[0], fresh) if copies else []
    # from here on only the copies hold the old database; its log goes first, so that the new one never uses it
    for suffix in ("-shm", "-wal"):
        Path(f"{database}{suffix}").unlink(missing_ok=True)
    fresh.replace(database)
    sync_folder(database.parent)
    return tables


def _copy_tables(damaged: Path, fresh: Path) -> list[RecoveredTable]:
    tables = []
    with closing(sqlite3.connect(fresh, isolation_level=None)) as new:
        new.execute("PRAGMA synchronous = FULL")
        for table in TABLES:
            tables.append(_copy_table(damaged, new, table))
        new.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        new.execute("PRAGMA journal_mode = DELETE")  # leaves everything in the one file that is moved
    return tables


def _copy_table(damaged: Path, new: sqlite3.Connection, table: str) -> RecoveredTable:
    columns = [row[1] for row in new.execute(f"PRAGMA table_info({table})")]
    recovered = rejected = 0
    errors: list[str] = []
    new.execute("BEGIN")
    for values in _readable_rows(damaged, table, errors):
        known = {name: value for name, value in values.items() if name in columns}
        sql = f"INSERT INTO {table} ({', '.join(known)}) VALUES ({', '.join('?' * len(known))})"
        try:
            new.execute(sql, list(known.values()))
            recovered += 1
        except sqlite3.Error:
            rejected += 1
    new.execute("COMMIT")
    return RecoveredTable(table, recovered, rejected, bool(errors))


def _readable_rows(damaged: Path, table: str, errors: list[str]) -> Iterator[dict[str, Any]]:
    """Yield each readable row once, and append to `errors` where reading fails.

    Reads upwards from the first row to the unreadable part, then downwards from the last row to it. Row ids in between
    are tried one by one.
    """
    with read_only(damaged) as db:  # must not change the copy
        low = high = None
        for ascending in (True, False):
            remaining = "" if low is None or ascending else f"WHERE rowid > {low}"
            order = f"ORDER BY rowid {'ASC' if ascending else 'DESC'}"
            reached = None
            try:
                for row in db.execute(f"SELECT rowid AS checked_rowid, * FROM {table} {remaining} {order}"):
                    values = dict(row)
                    reached = values.pop("checked_rowid")
                    yield values
            except sqlite3.DatabaseError as error:
                errors.append(str(error))
            else:
                return
            finally:
                if ascending:
                    low = reached
                else:
                    high = reached
        if low is None and high is None:  # the root page of the table is gone, so no row can be found
            return
        first = 1 if low is None else low + 1
        last = first + MAX_GAP_ROWS if high is None else min(high, first + MAX_GAP_ROWS)
        for rowid in range(first, last):
            with suppress(sqlite3.DatabaseError):  # the row is in the unreadable part
                for row in db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (rowid,)):
                    yield dict(row)
