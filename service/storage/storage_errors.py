"""Errors of a full disk and of a database that another program has locked."""

import errno
import sqlite3

from service.errors import Failure


def is_full(error: BaseException) -> bool:
    """Return whether the disk is full, for a file or for the database."""
    if isinstance(error, sqlite3.Error):
        return _code(error) == sqlite3.SQLITE_FULL
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def is_locked(error: BaseException) -> bool:
    """Return whether another program has locked the database."""
    return isinstance(error, sqlite3.Error) and _code(error) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


def storage_failure(error: BaseException, kept: str) -> Failure | None:
    """Return why a job ended, if the disk is full or the database is locked; None for any other error.

    Args:
        error: What ended the job.
        kept: Which of its data are kept.
    """
    if is_full(error):
        return Failure("storage-full", f"no space is left in the data folder; {kept}")
    if is_locked(error):
        return Failure("busy", f"another program locked the database for too long; {kept}")
    return None


def _code(error: sqlite3.Error) -> int:
    """Return the primary result code, which is the lower byte of the extended one."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF
