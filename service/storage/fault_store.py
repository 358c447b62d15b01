"""Storage of the cell's fault. A fault stays until a person acknowledges it, even if the service was restarted."""

import logging
import sqlite3
import threading
from collections.abc import Callable

from cell.control.cell import Cell
from cell.control.status import CellStatus
from service.storage.database import Database, now

log = logging.getLogger(__name__)

RETRY_S = 0.5
"""Interval of retries when the database cannot be written."""

Fault = tuple[str, str]
"""Slug and reason."""


class FaultStore:
    """Persists the cell's fault across restarts.

    It writes each fault and its acknowledgement in its own thread, because a stop must not wait for the database.
    """

    def __init__(self, database: Database, cell: Cell, on_fault: Callable[[str], None] | None = None) -> None:
        """Restore a fault that was not acknowledged before the service ended.

        Args:
            database: Database.
            cell: Cell whose faults are kept.
            on_fault: Called with the slug of each new fault. It must not block.
        """
        self._database, self._on_fault = database, on_fault
        found = database.one(lambda row: (row["slug"], row["reason"]), "SELECT slug, reason FROM cell_fault")
        if found is not None:
            cell.restore_fault(*found)
        self._written: Fault | None = found
        self._wanted: Fault | None = found
        self._changed = threading.Event()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fault-store", daemon=True)
        self._thread.start()
        cell.on_status(self._on_status)

    def close(self) -> None:
        """End the thread, and write the last state if the database can be written."""
        self._ending.set()
        self._changed.set()
        self._thread.join()
        self._write()  # a change that the thread did not see

    def _on_status(self, status: CellStatus) -> None:
        fault = (status.slug or "fault", status.reason or "") if status.state == "fault" else None
        if fault != self._wanted:
            self._wanted = fault
            self._changed.set()
            if fault is not None and self._on_fault is not None:
                self._on_fault(fault[0])

    def _run(self) -> None:
        while not self._ending.is_set():
            self._changed.wait()
            self._changed.clear()
            while not self._write() and not self._ending.wait(RETRY_S):
                pass

    def _write(self) -> bool:
        """Write the last state. Return whether the database has it."""
        wanted = self._wanted
        if wanted == self._written:
            return True
        try:
            with self._database.transaction() as db:
                db.execute("DELETE FROM cell_fault")
                if wanted is not None:
                    db.execute("INSERT INTO cell_fault (id, slug, reason, at) VALUES (1, ?, ?, ?)", (*wanted, now()))
        except sqlite3.Error:
            log.exception("the fault of the cell could not be written; the service tries again")
            return False
        self._written = wanted
        return True
