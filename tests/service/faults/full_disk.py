"""A simulated disk that is full from the n-th write on, until it has space again.

A write is a sync of a file or folder, or a commit of the database.
"""

import errno
import os
import sqlite3
import sys
import threading
import time
from typing import Any

import pytest

PRODUCT_FOLDERS = ("/service/", "/cell/", "/calibration/")
WRITING_HELPERS = ("database.py", "atomic_write.py", "hashed_file.py", "event_log.py")


class FullDisk:
    """Counts the writes of this process and refuses those from the n-th on."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._from: int | None = None
        self.sites: list[str] = []
        """The calling function of each write since `fill`."""
        self.refused = 0
        """Number of refused writes since `fill`."""
        self.first_refused_s = 0.0
        """Time of the first refused write, by `time.monotonic()`."""

    def fill(self, at: int | None) -> None:
        """Refuse the `at`-th write from now on, counted from 1, and all later ones. None refuses no write."""
        with self._lock:
            self._from, self.sites, self.refused = at, [], 0

    def clear(self) -> None:
        """Make space: refuse no more writes."""
        with self._lock:
            self._from = None

    def refuses(self) -> bool:
        """Count a write and return whether it is refused."""
        with self._lock:
            self.sites.append(_site())
            refused = self._from is not None and len(self.sites) >= self._from
            if refused and not self.refused:
                self.first_refused_s = time.monotonic()
            self.refused += refused
            return refused


def full_disk(monkeypatch: pytest.MonkeyPatch) -> FullDisk:
    """Replace the writes of this process by those to a simulated disk. Call it before the service starts."""
    disk, fsync, connect = FullDisk(), os.fsync, sqlite3.connect

    def checked_fsync(file: int) -> None:
        if disk.refuses():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(file)

    class Connection(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:  # type: ignore[override]
            if sql == "COMMIT" and disk.refuses():
                error = sqlite3.OperationalError("database or disk is full")
                error.sqlite_errorcode = sqlite3.SQLITE_FULL
                raise error
            return super().execute(sql, *values)

    def checked_connect(*arguments: Any, **options: Any) -> sqlite3.Connection:
        return connect(*arguments, **{"factory": Connection} | options)

    monkeypatch.setattr(os, "fsync", checked_fsync)
    monkeypatch.setattr(sqlite3, "connect", checked_connect)
    return disk


def _site() -> str:
    """Return the name of the product's function that writes."""
    frame = sys._getframe(2)
    while frame is not None:
        file = frame.f_code.co_filename.replace(os.sep, "/")
        if (
            any(part in file for part in PRODUCT_FOLDERS)
            and "/tests/" not in file
            and not file.endswith(WRITING_HELPERS)
        ):
            return frame.f_code.co_name
        frame = frame.f_back
    return "?"
