"""Audit log entries of the command line. They can be written while the service runs."""

import sqlite3
from contextlib import closing
from dataclasses import astuple
from pathlib import Path

from service.security.audit.log import INSERT, Entry
from service.security.auth.caller import LOCAL
from service.storage.data_folder import DATABASE
from service.storage.database import now

DATABASE_TIMEOUT_S = 2.0
"""Timeout for a database that another program has locked."""

COMMAND_LINE = "console"
"""Name of the command line in the audit log."""
UNKNOWN = "unknown"


def record_command(data_dir: Path, what: str) -> str | None:
    """Write an entry for a command.

    Args:
        data_dir: The data folder.
        what: The command, such as `token add anna operator`.

    Returns:
        None if the entry is on the disk, else the reason why it was not written.
    """
    path = data_dir / DATABASE
    if not path.is_file():
        return "it begins when the service first starts"
    # A user who may change the data folder may do everything, like a local client without tokens.
    entry = Entry(now(), COMMAND_LINE, LOCAL.role, what, None, UNKNOWN, 0, None)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", DATABASE_TIMEOUT_S, uri=True)) as db:
            db.execute("PRAGMA synchronous = FULL")
            with db:
                db.execute(INSERT, astuple(entry))
    except sqlite3.Error as error:
        return f"{path}: {error}"
    return None
