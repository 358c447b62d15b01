"""The SQLite database: its connections, its tables, and what is asked of it."""

import queue
import secrets
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from service.tables import MIGRATIONS, VERSION, stored

T = TypeVar("T")

BUSY_S = 5.0
"""How long a statement waits for another program that holds the database."""


class StoreVersionError(ValueError):
    """A database of a later version of this software."""

    slug = "store-version"


def new_id() -> str:
    """An id that is a safe file name and sorts by the moment of its making."""
    return f"{datetime.now(UTC):%Y%m%dt%H%M%S-%f}-{secrets.token_hex(4)}"


def now() -> str:
    """The present moment, RFC 3339 in UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Database:
    """One database file. Safe to use from any thread; every call may block."""

    def __init__(self, path: Path) -> None:
        """Makes the tables, or brings those of an earlier version up to date.

        Raises:
            StoreVersionError: they are of a later version.
        """
        self._path = path
        self._free: queue.SimpleQueue[sqlite3.Connection] = queue.SimpleQueue()
        try:
            self._make_tables()
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
