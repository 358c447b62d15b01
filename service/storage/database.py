"""The SQLite database: connections, transactions and ids."""

import logging
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
from service.storage.migrations import has_unknown_layout, latest_version, migrate
from service.storage.rows import stored

log = logging.getLogger(__name__)

T = TypeVar("T")

BUSY_S = 4.0
"""Timeout of a statement while another program locks the database. A request is answered within 5 s all the same."""

PAGE_CACHE_KIB = 128
"""Size of the page cache of each connection, KiB. There are up to as many connections as threads.

SQLite empties the cache when another connection has written, and the system caches the file once for all connections.
Lists of scans and events take as long as with SQLite's default of 2,000 KiB.
"""


class StoreVersionError(ValueError):
    """The database belongs to a later version of this software, or to none of its releases."""

    slug = "store-version"


_ID_TIME = "%Y%m%dt%H%M%S-%f"
"""Format of the time with which an id begins."""
_ID_GLOB = f"{'[0-9]' * 8}t{'[0-9]' * 6}-{'[0-9]' * 6}-*"
"""Pattern of ids for GLOB."""


class _IdClock:
    """Times of ids, each later than all before, even if the wall clock is set back."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = datetime.min.replace(tzinfo=UTC)

    def next(self) -> datetime:
        """Return the present time, or the next after the last one if the clock was set back."""
        with self._lock:
            self._last = max(wall_clock.utc_now(), self._last + timedelta(microseconds=1))
            return self._last

    def advance_past(self, used_id: str) -> None:
        """Return only times after that of an id that is in use."""
        if (moment := time_of_id(used_id)) is not None:
            with self._lock:
                self._last = max(moment, self._last)


_id_clock = _IdClock()


def new_id() -> str:
    """Return a new id, which is a safe file name and sorts after all earlier ids of the same database.

    It begins with the present time, unless the clock was set back.
    """
    return f"{_id_clock.next():{_ID_TIME}}-{secrets.token_hex(4)}"


def time_of_id(used_id: str) -> datetime | None:
    """Return the time with which an id begins; None if its digits are no date."""
    try:
        return datetime.strptime(used_id.rpartition("-")[0], _ID_TIME).replace(tzinfo=UTC)
    except ValueError:
        return None


def now() -> str:
    """Return the present time, RFC 3339 in UTC."""
    return wall_clock.format_utc(wall_clock.utc_now())


class Database:
    """One database file. Safe to use from any thread; every call may block."""

    def __init__(self, path: Path) -> None:
        """Create the tables, or migrate those of an earlier version. Tables of this version are not written.

        Where the disk has no space for the file that all programs share that use the database, its content is kept in
        memory. The database can be read all the same, and written as soon as there is space. Until it is closed,
        other programs find it locked.

        Raises:
            StoreVersionError: The tables are of a later version, or of none.
            sqlite3.Error: The database cannot be read, or its tables cannot be made.
        """
        self._path = path
        existed = path.exists()
        self._shared = True
        """Whether other programs can use the database, too."""
        self._free: queue.SimpleQueue[sqlite3.Connection] = queue.SimpleQueue()
        self.change = object()
        """Replaced after each change. Data that were read after taking this object are current while it is the same."""
        try:
            try:
                self._make_tables()
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode != sqlite3.SQLITE_IOERR_SHMSIZE:
                    raise
                log.warning("the disk is full: until the next start, other programs find %s locked", path)
                self.close()
                self._shared = False
                self._make_tables()
            for table in ("recordings", "scans", "calibrations"):
                newest = f"SELECT id FROM {table} WHERE id GLOB ? ORDER BY id DESC LIMIT 1"
                for used_id in self.all(lambda row: row["id"], newest, _ID_GLOB):
                    _id_clock.advance_past(used_id)
        except BaseException:
            self.close()
            if not existed and path.exists() and path.stat().st_size == 0:
                path.unlink()  # without tables: the disk is full
            raise

    def close(self) -> None:
        """Close all connections. The database must not be used any more."""
        while not self._free.empty():
            self._free.get().close()

    def connect(self, timeout_s: float) -> sqlite3.Connection:
        """Open a connection for one thread. The caller closes it before the database is closed.

        Args:
            timeout_s: Timeout of a statement while another connection locks the database.
        """
        address = self._path.absolute().as_uri() + ("" if self._shared else "?vfs=unix-excl")
        return sqlite3.connect(address, timeout_s, uri=True, check_same_thread=False)

    @contextmanager
    def connection(self) -> Iterator[sqlite3.Connection]:
        """Provide a connection to the calling thread."""
        try:
            connection = self._free.get_nowait()
        except queue.Empty:
            connection = self._open()
        try:
            yield connection
        finally:
            self._free.put(connection)

    def _open(self) -> sqlite3.Connection:
        connection = self.connect(BUSY_S)  # passed from thread to thread, but used by one at a time
        connection.isolation_level = None
        connection.row_factory = sqlite3.Row
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute(f"PRAGMA cache_size = -{PAGE_CACHE_KIB}")
        except BaseException:
            connection.close()
            raise
        return connection

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Provide a connection with a transaction. It is on disk at the end, or rolled back after an error."""
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
        """Provide a connection that reads one consistent state, whatever is written meanwhile."""
        with self.connection() as db:
            db.execute("BEGIN")
            try:
                yield db
            finally:
                if db.in_transaction:
                    db.execute("ROLLBACK")

    def all(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> list[T]:
        """Return all rows of a query, each converted by `make`."""
        with self.connection() as db:
            return [make(row) for row in db.execute(sql, values).fetchall()]

    def one(self, make: Callable[[sqlite3.Row], T], sql: str, *values: Any) -> T | None:
        """Return the first row of a query, converted by `make`; None if there is none."""
        rows = self.all(make, sql, *values)
        return rows[0] if rows else None

    def _make_tables(self) -> None:
        with self.connection() as db:
            is_unknown = has_unknown_layout(db)
            (version,) = db.execute("PRAGMA user_version").fetchone()
        if is_unknown:
            raise StoreVersionError(f"{self._path} has tables that no release of Pointchain made: use another data_dir")
        if version > latest_version():
            raise StoreVersionError(
                f"{self._path} has tables of version {version}, this software knows {latest_version()}: "
                "use a later release, or another data_dir"
            )
        if version < latest_version():
            with self.transaction() as db:
                migrate(db)


def update(db: sqlite3.Connection, table: str, row_id: str, only_in: Sequence[str], values: dict[str, Any]) -> bool:
    """Set columns of a row if its state is one of `only_in`. Return whether they were set."""
    assignments = ", ".join(f"{name} = ?" for name in values)
    sql = f"UPDATE {table} SET {assignments} WHERE id = ? AND state IN ({', '.join('?' * len(only_in))})"
    return db.execute(sql, (*map(stored, values.values()), row_id, *only_in)).rowcount == 1
