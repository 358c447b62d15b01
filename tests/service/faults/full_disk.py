"""A disk that is full from the n-th write on, until there is space again.

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

OURS = ("/service/", "/cell/", "/calibration/")
NOT_THE_SITE = ("database.py", "atomic_write.py", "hashed_file.py", "event_log.py")


class FullDisk:
    """Counts the writes of this process, and refuses those from the n-th on."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._from: int | None = None
        self.sites: list[str] = []
        """Of each write since `fill`: the function that it was for."""
        self.refused = 0
        self.first_refused_s = 0.0
        """`time.monotonic()`."""

    def fill(self, at: int | None) -> None:
        """The `at`-th write from now on, counted from 1, and all later ones are refused; None: none is."""
        with self._lock:
            self._from, self.sites, self.refused = at, [], 0

    def clear(self) -> None:
        """There is space again."""
        with self._lock:
            self._from = None

    def refuses(self) -> bool:
        """Whether this write is."""
        with self._lock:
            self.sites.append(_site())
            refused = self._from is not None and len(self.sites) >= self._from
            if refused and not self.refused:
                self.first_refused_s = time.monotonic()
            self.refused += refused
            return refused


def full_disk(monkeypatch: pytest.MonkeyPatch) -> FullDisk:
    """For the service of this process, which must be started after this."""
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
    frame = sys._getframe(2)
    while frame is not None:
        file = frame.f_code.co_filename.replace(os.sep, "/")
        if any(part in file for part in OURS) and "/tests/" not in file and not file.endswith(NOT_THE_SITE):
            return frame.f_code.co_name
        frame = frame.f_back
    return "?"
