"""A fault of the cell is remembered over a restart: nobody has looked at the cell just because the service ended."""

import logging
import sqlite3
import threading
from collections.abc import Callable

from cell.control.cell import Cell
from cell.control.status import CellStatus
from service.storage.database import Database, now

log = logging.getLogger(__name__)

AGAIN_S = 0.5
"""What the database did not take is written again after so long."""

Fault = tuple[str, str]
"""Slug and reason."""


class FaultMemory:
    """Writes down that there is a fault, and that it was acknowledged, in a thread of its own: whoever stops the arm
    waits for no database."""

    def __init__(self, database: Database, cell: Cell, told: Callable[[str], None] | None = None) -> None:
        """A fault that was not acknowledged before the service ended is the cell's again.

        `told` is called with the slug of each new one; it must not wait.
        """
        self._database, self._told = database, told
        found = database.one(lambda row: (row["slug"], row["reason"]), "SELECT slug, reason FROM cell_fault")
        if found is not None:
            cell.restore_fault(*found)
        self._written: Fault | None = found
        self._wanted: Fault | None = found
        self._changed = threading.Event()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fault-memory", daemon=True)
        self._thread.start()
        cell.on_status(self._see)

    def close(self) -> None:
        """What is known is written, if the database takes it."""
        self._ending.set()
        self._changed.set()
        self._thread.join()
        self._write()  # what has changed since its last look

    def _see(self, status: CellStatus) -> None:
        fault = (status.slug or "fault", status.reason or "") if status.state == "fault" else None
        if fault != self._wanted:
            self._wanted = fault
            self._changed.set()
            if fault is not None and self._told is not None:
                self._told(fault[0])

    def _run(self) -> None:
        while not self._ending.is_set():
            self._changed.wait()
            self._changed.clear()
            while not self._write() and not self._ending.wait(AGAIN_S):
                pass

    def _write(self) -> bool:
        """Whether the database has what is wanted."""
        wanted = self._wanted
        if wanted == self._written:
            return True
        try:
            with self._database.transaction() as db:
                db.execute("DELETE FROM cell_fault")
                if wanted is not None:
                    db.execute("INSERT INTO cell_fault (id, slug, reason, at) VALUES (1, ?, ?, ?)", (*wanted, now()))
        except sqlite3.Error:
            log.exception("the cell's fault could not be written; it is tried again")
            return False
        self._written = wanted
        return True
