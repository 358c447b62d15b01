"""Read the audit log. It takes no lock, and works while the service runs."""

import sqlite3
from contextlib import closing
from pathlib import Path

from service.security.audit.log import Entry
from service.storage.data_folder import DATABASE
from service.storage.storage_errors import is_locked

DATABASE_TIMEOUT_S = 5.0
SCAN_CONDITION = "(scan = ? OR instr(what || '/', '/api/scans/' || ? || '/') > 0)"
"""The id may be the last part of a path, so a slash is appended before the comparison."""


class AuditError(ValueError):
    """The audit log cannot be read."""

    slug = "audit"


def read_audit(data_dir: Path, since: str | None, scan: str | None, who: str | None, limit: int) -> list[Entry]:
    """Return the newest entries, in the order in which they were made.

    Args:
        data_dir: The data folder.
        since: Earliest time, in the form of `database.now`. None: any time.
        scan: Id of a scan. It also selects the entries whose path names the scan, such as a reprocess request, which
            has the id of the new scan. None: any scan.
        who: Name of the caller. None: any caller.
        limit: Maximum number of entries.

    Raises:
        AuditError: There is no audit log, or it cannot be read.
    """
    path = data_dir / DATABASE
    if not path.is_file():
        raise AuditError(f"there is no {path}: no service has run with this data folder")
    wanted = {"at >= ?": since, SCAN_CONDITION: scan, "who = ?": who}
    conditions = [condition for condition, value in wanted.items() if value is not None]
    values = [value for condition, value in wanted.items() if value is not None for _ in range(condition.count("?"))]
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    columns = ", ".join(Entry.__dataclass_fields__)
    sql = f"SELECT {columns} FROM audit {where} ORDER BY id DESC LIMIT ?"
    try:
        uri = f"{path.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, DATABASE_TIMEOUT_S, uri=True)) as db:
            rows = db.execute(sql, (*values, limit)).fetchall()
    except sqlite3.Error as error:
        advice = (
            "; if the service has started on a full disk, restart it when there is space" if is_locked(error) else ""
        )
        raise AuditError(f"{path} cannot be read: {error}{advice}") from error
    return [Entry(*row) for row in reversed(rows)]
