"""The audit log as it is read: without a lock, beside a running service."""

import sqlite3
from contextlib import closing
from pathlib import Path

from service.security.audit.log import Entry
from service.storage.data_folder import DATABASE

WAIT_S = 5.0
OF_SCAN = "(scan = ? OR instr(what || '/', '/api/scans/' || ? || '/') > 0)"
"""An address may end with the scan's id."""


class AuditError(ValueError):
    """An audit log that cannot be read."""

    slug = "audit"


def read_audit(data_dir: Path, since: str | None, scan: str | None, who: str | None, limit: int) -> list[Entry]:
    """The newest entries, at most `limit`, in the order of their making; `since` is in the form of `database.now`.
    Those of a scan are also those whose address names it, as of a reprocess, which is the new scan's.

    Raises:
        AuditError: there is no such log, or it cannot be read.
    """
    path = data_dir / DATABASE
    if not path.is_file():
        raise AuditError(f"there is no {path}: no service has run with this data folder")
    wanted = {"at >= ?": since, OF_SCAN: scan, "who = ?": who}
    conditions = [condition for condition, value in wanted.items() if value is not None]
    values = [value for condition, value in wanted.items() if value is not None for _ in range(condition.count("?"))]
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    columns = ", ".join(Entry.__dataclass_fields__)
    sql = f"SELECT {columns} FROM audit {where} ORDER BY id DESC LIMIT ?"
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", WAIT_S, uri=True)) as db:
            rows = db.execute(sql, (*values, limit)).fetchall()
    except sqlite3.Error as error:
        raise AuditError(f"{path} cannot be read: {error}") from error
    return [Entry(*row) for row in reversed(rows)]
