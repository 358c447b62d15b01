"""A new database out of a damaged one: table by table, row by row, whatever can still be read."""

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

MOST_GAP = 100_000
"""Between the rows that can be read from both sides, so many numbers are tried one by one."""


@dataclass(frozen=True)
class Salvaged:
    """What became of one table."""

    table: str
    saved: int
    refused: int
    """Rows that could be read, but hold what cannot be."""
    cut: bool
    """There was a place that cannot be read: rows may be lost there."""


def salvage(database: Path, lost: LostAndFound) -> list[Salvaged]:
    """Puts a copy of the database's files aside and a new database in its place. No other may have it open.

    Raises:
        OSError: there is no space, say; then all is as it was.
    """
    files = [path for suffix in ("", "-wal") if (path := Path(f"{database}{suffix}")).exists()]
    copies = [lost.copy(path, "the damaged database") for path in files]
    fresh = database.with_name(f".{database.name}.new")
    for suffix in ("", "-wal", "-shm"):
        Path(f"{fresh}{suffix}").unlink(missing_ok=True)  # of a repair that was killed
    Database(fresh).close()
    told = _copied(copies[0], fresh) if copies else []
    # From here on the old one is in the copies alone. Its log goes first: it is not the new one's.
    for suffix in ("-shm", "-wal"):
        Path(f"{database}{suffix}").unlink(missing_ok=True)
    fresh.replace(database)
    sync_folder(database.parent)
    return told


def _copied(damaged: Path, fresh: Path) -> list[Salvaged]:
    told = []
    with closing(sqlite3.connect(fresh, isolation_level=None)) as new:
        new.execute("PRAGMA synchronous = FULL")
        for table in TABLES:
            told.append(_copy_table(damaged, new, table))
        new.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        new.execute("PRAGMA journal_mode = DELETE")  # all in the one file that is moved
    return told


def _copy_table(damaged: Path, new: sqlite3.Connection, table: str) -> Salvaged:
    columns = [row[1] for row in new.execute(f"PRAGMA table_info({table})")]
    saved = refused = 0
    cut: list[str] = []
    new.execute("BEGIN")
    for values in _readable(damaged, table, cut):
        known = {name: value for name, value in values.items() if name in columns}
        sql = f"INSERT INTO {table} ({', '.join(known)}) VALUES ({', '.join('?' * len(known))})"
        try:
            new.execute(sql, list(known.values()))
            saved += 1
        except sqlite3.Error:
            refused += 1
    new.execute("COMMIT")
    return Salvaged(table, saved, refused, bool(cut))


def _readable(damaged: Path, table: str, cut: list[str]) -> Iterator[dict[str, Any]]:
    """Each row once: from the first up to where it breaks off, from the last down to there, and what lies between one
    by one. Notes in `cut` that there is such a place."""
    with read_only(damaged) as db:  # the copy stays as it is
        low = high = None
        for upwards in (True, False):
            beyond = "" if low is None or upwards else f"WHERE rowid > {low}"
            order = f"ORDER BY rowid {'ASC' if upwards else 'DESC'}"
            reached = None
            try:
                for row in db.execute(f"SELECT rowid AS doctor_rowid, * FROM {table} {beyond} {order}"):
                    values = dict(row)
                    reached = values.pop("doctor_rowid")
                    yield values
            except sqlite3.DatabaseError as error:
                cut.append(str(error))
            else:
                return
            finally:
                if upwards:
                    low = reached
                else:
                    high = reached
        if low is None and high is None:  # its root is gone: no row is found by any way
            return
        first = 1 if low is None else low + 1
        last = first + MOST_GAP if high is None else min(high, first + MOST_GAP)
        for rowid in range(first, last):
            with suppress(sqlite3.DatabaseError):  # it is in the place that cannot be read
                for row in db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (rowid,)):
                    yield dict(row)
