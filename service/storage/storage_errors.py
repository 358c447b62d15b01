"""What the disk and the database say when they take nothing more, told apart."""

import errno
import sqlite3


def is_full(error: BaseException) -> bool:
    """No space is left, for the file or for the database."""
    if isinstance(error, sqlite3.Error):
        return _code(error) == sqlite3.SQLITE_FULL
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def is_held(error: BaseException) -> bool:
    """Another program holds the database."""
    return isinstance(error, sqlite3.Error) and _code(error) in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


def _code(error: sqlite3.Error) -> int:
    """The primary one: the lower byte of those that tell more."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF
