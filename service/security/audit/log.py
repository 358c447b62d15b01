"""Who did what, when, and what came of it: the table `audit`, which is only ever added to.

A thread of its own writes it. What the database does not take at once waits in memory and is written later, so that a
database that another program holds keeps nobody from stopping the arm.
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
from pathlib import Path

from service.security.audit.repeats import Repeats
from service.storage.database import now

log = logging.getLogger(__name__)

AT_ONCE_S = 0.5
"""An answer waits so long for its entry to be on the disk."""
RETRY_S = 0.5
"""How long the database is waited for, and how long until it is tried again."""
ENDING_S = 1.0
"""At the end of the service, what is left is tried for so long."""
PENDING_MOST = 10_000
"""So many entries wait in memory; later ones are lost, which the log tells."""
BATCH = 500

SERVICE = "service"


@dataclass(frozen=True)
class Entry:
    """A row of the table."""

    at: str
    who: str
    """A token's name, `local`, `service`, `console` for the command line, or the address of somebody who did not say
    who he is."""
    role: str
    what: str
    """As `POST /api/scans`."""
    scan: str | None
    """The one that was started or stopped; else the one that the address names."""
    cell: str
    """The cell's state at that moment; `unknown` to the command line."""
    status: int
    """Of the answer; 0: there was none."""
    result: str | None
    """The problem's slug; `replayed`: an earlier request with this idempotency key had done it; None: it was done."""


INSERT = f"INSERT INTO audit ({', '.join(field.name for field in fields(Entry))}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"


class AuditLog:
    """The log as the service writes it. Safe to use from any thread."""

    def __init__(self) -> None:
        self._cell_state: Callable[[], str] = lambda: "not_ready"
        self._pending: deque[tuple[Entry, Callable[[], None] | None]] = deque()
        self._changed = threading.Condition()
        self._repeats = Repeats()
        self._thread: threading.Thread | None = None
        self._closing = False
        self._behind = False
        self._lost = 0

    def start(self, database: Path, cell_state: Callable[[], str]) -> None:
        """Begins to write. The tables must be there; `cell_state` is asked for each entry and must answer at once."""
        self._cell_state = cell_state
        self._thread = threading.Thread(target=self._write, args=(database,), name="audit", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Writes what is left, as far as the database takes it."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not None:
            # Its last try may just have begun to wait for the database.
            self._thread.join(ENDING_S + 2 * RETRY_S)
        with self._changed:
            if lost := len(self._pending) + self._lost:
                log.error("the audit log has lost %d entries: the database did not take them", lost)

    def note(
        self,
        who: str,
        what: str,
        *,
        role: str = SERVICE,
        scan: str | None = None,
        status: int = 0,
        result: str | None = None,
    ) -> None:
        """Adds an entry; returns at once, it is written later."""
        self._add(self._entry(who, role, what, scan, status, result), None)

    async def record(
        self, who: str, role: str, what: str, scan: str | None, status: int, result: str | None, wait: bool
    ) -> None:
        """Adds an entry; with `wait`, returns when it is on the disk, or cannot be at once."""
        entry = self._entry(who, role, what, scan, status, result)
        if wait:
            await self._add_and_wait(entry)
        else:
            self._add(entry, None)

    async def refused(self, who: str, role: str, what: str, alike: str, status: int, result: str | None) -> None:
        """Adds a refusal as `record` does, unless one of `alike` was added a moment ago: those are counted, and written
        as one."""
        entry = self._entry(who, role, what, None, status, result)
        if self._repeats.first((who, alike, status, result), entry, time.monotonic()):
            await self._add_and_wait(entry)

    async def _add_and_wait(self, entry: Entry) -> None:
        if self._behind or self._thread is None:
            self._add(entry, None)
            return
        loop = asyncio.get_running_loop()
        written = loop.create_future()

        def tell() -> None:
            if not written.done():
                written.set_result(None)

        def tell_from_there() -> None:
            loop.call_soon_threadsafe(tell)

        self._add(entry, tell_from_there)
        with suppress(TimeoutError):
            await asyncio.wait_for(written, AT_ONCE_S)

    def _entry(self, who: str, role: str, what: str, scan: str | None, status: int, result: str | None) -> Entry:
        return Entry(now(), who, role, what, scan, self._cell_state(), status, result)

    def _add(self, entry: Entry, written: Callable[[], None] | None) -> None:
        with self._changed:
            if len(self._pending) >= PENDING_MOST:
                if not self._lost:
                    log.error("the audit log loses entries: the database does not take them")
                self._lost += 1
                return
            self._pending.append((entry, written))
            self._changed.notify_all()

    def _write(self, database: Path) -> None:
        """Until the end: whatever there is, as one change."""
        give_up: float | None = None
        with closing(sqlite3.connect(database, RETRY_S)) as db:
            db.execute("PRAGMA synchronous = FULL")
            while True:
                with self._changed:
                    if not self._pending and not self._closing:
                        self._changed.wait(timeout=self._repeats.window_s)
                    ending = self._closing
                for entry, times in self._repeats.ended(time.monotonic(), everything=ending):
                    self._add(_repeated(entry, times), None)
                with self._changed:
                    batch = list(islice(self._pending, BATCH))
                if batch:
                    self._behind = not self._insert(db, [entry for entry, _ in batch])
                    if not self._behind:
                        self._done(batch)
                elif ending:
                    return
                if self._behind:
                    if ending:
                        give_up = give_up or time.monotonic() + ENDING_S
                        if time.monotonic() > give_up:
                            return
                    time.sleep(RETRY_S / 10 if ending else RETRY_S)

    def _insert(self, db: sqlite3.Connection, entries: list[Entry]) -> bool:
        """Writes entries; says whether they are done with."""
        try:
            with db:
                db.executemany(INSERT, [astuple(entry) for entry in entries])
        except sqlite3.Error as error:
            log.log(logging.DEBUG if self._behind else logging.WARNING, "the audit log is written later: %s", error)
            return False
        except ValueError:  # a text that is no Unicode would be in the way of all others for ever
            log.exception("%d entries of the audit log cannot be written", len(entries))
        return True

    def _done(self, batch: list[tuple[Entry, Callable[[], None] | None]]) -> None:
        with self._changed:
            for _ in batch:
                self._pending.popleft()
            lost, self._lost = self._lost, 0
        if lost:
            log.error("the audit log has lost %d entries while the database did not take them", lost)
        for _, written in batch:
            if written is not None:
                with suppress(RuntimeError):  # the event loop has ended
                    written()


def _repeated(entry: Entry, times: int) -> Entry:
    return replace(entry, at=now(), what=f"{entry.what} ({times} times more)")
