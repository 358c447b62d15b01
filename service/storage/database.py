"""The SQLite database: its connections, its tables, and what is asked of it."""

import queue
import secrets
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

from service import clock as wall_clock
from service.storage.migrations import MIGRATIONS, VERSION
from service.storage.rows import stored

T = TypeVar("T")

BUSY_S = 4.0
"""How long a statement waits for another program that holds the database. With all else that a request may wait for,
its answer comes within 5 s."""


class StoreVersionError(ValueError):
    """A database of a later version of this software."""

    slug = "store-version"


_MOMENT = "%Y%m%dt%H%M%S-%f"
"""By which an id begins."""
_OURS = f"{'[0-9]' * 8}t{'[0-9]' * 6}-{'[0-9]' * 6}-*"
"""The same for GLOB."""


class _Moments:
    """The moments of ids, each later than all before, whatever the wall clock does."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = datetime.min.replace(tzinfo=UTC)

    def next(self) -> datetime:
        """The present one, or the next after the last where the clock was set back."""
        with self._lock:
            self._last = max(wall_clock.present(), self._last + timedelta(microseconds=1))
            return self._last

    def go_on_behind(self, given_id: str) -> None:
        """Later ones only: this id was given already."""
        try:
            moment = datetime.strptime(given_id.rpartition("-")[0], _MOMENT).replace(tzinfo=UTC)
        except ValueError:  # digits alone make no date
            return
        with self._lock:
            self._last = max(moment, self._last)


_moments = _Moments()


def new_id() -> str:
    """An id that is a safe file name and sorts behind all that were made before, also by earlier services on the same
    database. It is the moment of its making, unless the clock was set back since."""
    return f"{_moments.next():{_MOMENT}}-{secrets.token_hex(4)}"


def now() -> str:
    """The present moment, RFC 3339 in UTC."""
    return wall_clock.stamp(wall_clock.present())


class Database:
    """One database file. Safe to use from any thread; every call may block."""

    def __init__(self, path: Path) -> None:
        """Makes the tables, or brings those of an earlier version up to date.

        Raises:
            StoreVersionError: they are of a later version.
        """
        self._path = path
        self._free: queue.SimpleQueue[sqlite3.Connection] = queue.SimpleQueue()
        self.change = object()
        """Another one after each change that was made: what was read behind it is as it was while it is the same."""
        try:
            self._make_tables()
            for table in ("recordings", "scans", "calibrations"):
                newest = f"SELECT id FROM {table} WHERE id GLOB ? ORDER BY id DESC LIMIT 1"
                for given_id in self.all(lambda row: row["id"], newest, _OURS):
                    _moments.go_on_behind(given_id)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Closes all connections; nothing may use the database any more."""
        while not self._free.empty():
            self._free.get().close()

    @contextmanager
    def connection(self) -> Iterator[sqlite3.Connection]:
        """A connection for this thread, for as long as it lasts."""
        try:
            connection = self._free.get_nowait()
        except queue.Empty:
            # Handed from thread to thread, but used by one at a time.
            connection = sqlite3.connect(self._path, BUSY_S, check_same_thread=False)
            connection.isolation_level = None
            connection.row_factory = sqlite3.Row
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
        try:
            yield connection
        finally:
            self._free.put(connection)

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """The same as one change: on the disk when it is left in order, else not made."""
        with self.connection() as db:
            db.execute("BEGIN IMMEDIATE")
            try:
                yield db
                db.execute("COMMIT")
                self.change = object()
            except BaseException:
                if db.in_transaction:
                    db.execute("ROLLBACK")
                raise

    @contextmanager
    def snapshot(self) -> Iterator[sqlite3.Connection]:
        """A connection that reads the database as it is at one moment, whatever is written meanwhile."""
        with self.connection() as db:
            db.execute("BEGIN")
            try:
                yield db
            finally:
                if db.in_transaction:
                    db.execute("ROLLBACK")

    def all(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> list[T]:
        """What `make` makes of each row found."""
        with self.connection() as db:
            return [make(row) for row in db.execute(sql, values).fetchall()]

    def one(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> T | None:
        """What it makes of the first; None when there is none."""
        rows = self.all(make, sql, *values)
        return rows[0] if rows else None

    def _make_tables(self) -> None:
        with self.transaction() as db:
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version > VERSION:
                raise StoreVersionError(
                    f"{self._path} has tables of version {version}, this software knows {VERSION}: "
                    "use a later release, or another data_dir"
                )
            for migration in MIGRATIONS[version:]:
                for statement in _statements(migration):
                    db.execute(statement)
            db.execute(f"PRAGMA user_version = {VERSION}")


def _statements(script: str) -> Iterator[str]:
    """One by one: sqlite3's own `executescript` would end the transaction. A trigger has semicolons inside."""
    statement = ""
    for line in script.splitlines(keepends=True):
        statement += line
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""


def update(db: sqlite3.Connection, table: str, row_id: str, only_in: Sequence[str], values: dict[str, Any]) -> bool:
    """Sets columns of a row, unless its state is not one of `only_in`; says whether it did."""
    assignments = ", ".join(f"{name} = ?" for name in values)
    sql = f"UPDATE {table} SET {assignments} WHERE id = ? AND state IN ({', '.join('?' * len(only_in))})"
    return db.execute(sql, (*map(stored, values.values()), row_id, *only_in)).rowcount == 1
