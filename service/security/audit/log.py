"""The table `audit`: who requested what, when, and with which result. Rows are only ever added.

A thread writes the table. Entries that the database does not accept at once wait in memory, so that a stop request
never waits for a database that another program has locked.
"""

import asyncio
import logging
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import astuple, dataclass, fields, replace
from itertools import islice

from service.security.audit.repeats import RepeatCounter
from service.storage.database import now

log = logging.getLogger(__name__)

WRITE_TIMEOUT_S = 0.5
"""Maximum time for which an answer waits until its entry is on the disk."""
RETRY_S = 0.5
"""Timeout for a locked database, and delay before the next attempt."""
CLOSE_TIMEOUT_S = 1.0
"""Timeout for writing the remaining entries at the end of the service."""
MAX_PENDING = 10_000
"""Maximum number of entries in memory. Further entries are lost, which is logged."""
BATCH_SIZE = 500

SERVICE = "service"
"""Name of the service itself in the audit log."""


@dataclass(frozen=True)
class Entry:
    """A row of the table."""

    at: str
    who: str
    """Name of the token, `local`, `service`, `console` for the command line, or the address of an unknown client."""
    role: str
    what: str
    """Method and path of the request, such as `POST /api/scans`."""
    scan: str | None
    """Id of the scan that was started or stopped, else of the scan in the path."""
    cell: str
    """State of the cell at that time. For the command line, it is `unknown`."""
    status: int
    """Status of the answer, or 0 if there was none."""
    result: str | None
    """Slug of the problem, or None if the request succeeded.

    `replayed` means that an earlier request with the same idempotency key did the work.
    """


INSERT = f"INSERT INTO audit ({', '.join(field.name for field in fields(Entry))}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"


class AuditLog:
    """The writer of the audit log. Safe to use from any thread."""

    def __init__(self) -> None:
        self._cell_state: Callable[[], str] = lambda: "not_ready"
        self._pending: deque[tuple[Entry, Callable[[], None] | None]] = deque()
        """Entries that are not written, each with a callback for when it is."""
        self._changed = threading.Condition()
        self._repeats: RepeatCounter[Entry] = RepeatCounter()
        self._thread: threading.Thread | None = None
        self._closing = False
        self._delayed = False
        """Whether the database did not accept the last batch."""
        self._lost = 0

    def start(self, connect: Callable[[float], sqlite3.Connection], cell_state: Callable[[], str]) -> None:
        """Start to write.

        Args:
            connect: Opens a connection to the database, which has its tables. The argument is the timeout of a
                statement, seconds.
            cell_state: Returns the state of the cell for each entry. It must not block.
        """
        self._cell_state = cell_state
        self._thread = threading.Thread(target=self._write, args=(connect,), name="audit", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the remaining entries, if the database accepts them in time."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not None:
            # The last attempt may have started just before the timeout.
            self._thread.join(CLOSE_TIMEOUT_S + 2 * RETRY_S)
        with self._changed:
            if lost := len(self._pending) + self._lost:
                log.error("the audit log has lost %d entries, because the database did not accept them", lost)

    def add(
        self,
        who: str,
        what: str,
        *,
        role: str = SERVICE,
        scan: str | None = None,
        status: int = 0,
        result: str | None = None,
    ) -> None:
        """Add an entry and return at once. It is written later."""
        self._append(self._entry(who, role, what, scan, status, result), None)

    async def record(
        self, who: str, role: str, what: str, scan: str | None, status: int, result: str | None, wait: bool
    ) -> None:
        """Add an entry.

        Args:
            who: Name of the caller.
            role: Role of the caller.
            what: Method and path of the request.
            scan: Id of the scan that the request is about.
            status: Status of the answer.
            result: Slug of the problem, `replayed`, or None.
            wait: Whether to return only when the entry is on the disk, or cannot be written at once.
        """
        entry = self._entry(who, role, what, scan, status, result)
        if wait:
            await self._append_and_wait(entry)
        else:
            self._append(entry, None)

    async def record_refusal(self, who: str, role: str, what: str, group: str, status: int, result: str | None) -> None:
        """Add the entry of a refused request. Repeated refusals are counted and written as one entry.

        Args:
            who: Name of the caller.
            role: Role of the caller.
            what: Method and path of the request.
            group: Refusals of the same caller, group, status and result count as repeated.
            status: Status of the answer.
            result: Slug of the problem.
        """
        entry = self._entry(who, role, what, None, status, result)
        if self._repeats.is_first((who, group, status, result), entry, time.monotonic()):
            await self._append_and_wait(entry)

    async def _append_and_wait(self, entry: Entry) -> None:
        if self._delayed or self._thread is None:
            self._append(entry, None)
            return
        loop = asyncio.get_running_loop()
        written = loop.create_future()

        def set_written() -> None:
            if not written.done():
                written.set_result(None)

        def notify_loop() -> None:
            loop.call_soon_threadsafe(set_written)

        self._append(entry, notify_loop)
        with suppress(TimeoutError):
            await asyncio.wait_for(written, WRITE_TIMEOUT_S)

    def _entry(self, who: str, role: str, what: str, scan: str | None, status: int, result: str | None) -> Entry:
        return Entry(now(), who, role, what, scan, self._cell_state(), status, result)

    def _append(self, entry: Entry, on_written: Callable[[], None] | None) -> None:
        with self._changed:
            if len(self._pending) >= MAX_PENDING:
                if not self._lost:
                    log.error("the audit log loses entries, because the database does not accept them")
                self._lost += 1
                return
            self._pending.append((entry, on_written))
            self._changed.notify_all()

    def _write(self, connect: Callable[[float], sqlite3.Connection]) -> None:
        """Write the pending entries in batches, each in one transaction, until the log is closed."""
        deadline: float | None = None
        with closing(connect(RETRY_S)) as db:
            db.execute("PRAGMA synchronous = FULL")
            while True:
                with self._changed:
                    if not self._pending and not self._closing:
                        self._changed.wait(timeout=self._repeats.window_s)
                    ending = self._closing
                for entry, times in self._repeats.pop_ended(time.monotonic(), everything=ending):
                    self._append(_repeated(entry, times), None)
                with self._changed:
                    batch = list(islice(self._pending, BATCH_SIZE))
                if batch:
                    self._delayed = not self._insert(db, [entry for entry, _ in batch])
                    if not self._delayed:
                        self._remove_written(batch)
                elif ending:
                    return
                if self._delayed:
                    if ending:
                        deadline = deadline or time.monotonic() + CLOSE_TIMEOUT_S
                        if time.monotonic() > deadline:
                            return
                    time.sleep(RETRY_S / 10 if ending else RETRY_S)

    def _insert(self, db: sqlite3.Connection, entries: list[Entry]) -> bool:
        """Write a batch; return False if it must be written again."""
        try:
            with db:
                db.executemany(INSERT, [astuple(entry) for entry in entries])
        except sqlite3.Error as error:
            level = logging.DEBUG if self._delayed else logging.WARNING
            log.log(level, "entries of the audit log wait in memory and are written later: %s", error)
            return False
        except ValueError:  # text that is not valid Unicode would block all later entries for ever
            log.exception("%d entries of the audit log cannot be written", len(entries))
        return True

    def _remove_written(self, batch: list[tuple[Entry, Callable[[], None] | None]]) -> None:
        with self._changed:
            for _ in batch:
                self._pending.popleft()
            lost, self._lost = self._lost, 0
        if lost:
            log.error("the audit log has lost %d entries while the database did not accept them", lost)
        for _, on_written in batch:
            if on_written is not None:
                with suppress(RuntimeError):  # the event loop has ended
                    on_written()


def _repeated(entry: Entry, times: int) -> Entry:
    return replace(entry, at=now(), what=f"{entry.what} (repeated {times} times)")
