"""What was done on the command line, in the audit log of the service; also while that runs."""

import sqlite3
from contextlib import closing
from dataclasses import astuple
from pathlib import Path

from service.security.audit.log import INSERT, Entry
from service.security.auth.caller import LOCAL
from service.storage.data_folder import DATABASE
from service.storage.database import now

WAIT_S = 2.0
"""A database that somebody else holds is waited for so long."""

CONSOLE = "console"
UNKNOWN = "unknown"


def note_from_console(data_dir: Path, what: str) -> str | None:
    """Adds an entry, as `token add anna operator`. None: it is on the disk; else why the log has no entry of it."""
    path = data_dir / DATABASE
    if not path.is_file():
        return f"there is no {path} yet"
    # Whoever may change the data folder may do everything, as who is on this machine while there is no token.
    entry = Entry(now(), CONSOLE, LOCAL.role, what, None, UNKNOWN, 0, None)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", WAIT_S, uri=True)) as db:
            db.execute("PRAGMA synchronous = FULL")
            with db:
                db.execute(INSERT, astuple(entry))
    except sqlite3.Error as error:
        return f"{path}: {error}"
    return None
