"""Tables of the database, and their migration from earlier versions."""

import sqlite3
from collections.abc import Iterator

APPLICATION_ID = 0x504F4943
"""SQLite's `application_id` of the database, by which it is known from the databases of other programs."""
MIGRATIONS: tuple[str, ...] = (
    """
CREATE TABLE recordings (
    id TEXT PRIMARY KEY, created_at TEXT NOT NULL, size_bytes BIGINT NOT NULL, sha256 TEXT NOT NULL,
    views INTEGER NOT NULL, missing TEXT NOT NULL, string_radius_m DOUBLE PRECISION,
    table_z_m DOUBLE PRECISION NOT NULL, provenance TEXT NOT NULL, name TEXT, simulated INTEGER
);
CREATE TABLE scans (
    id TEXT PRIMARY KEY, mode TEXT NOT NULL, recording TEXT REFERENCES recordings (id), request TEXT NOT NULL,
    state TEXT NOT NULL, stage TEXT, fraction DOUBLE PRECISION NOT NULL,
    created_at TEXT NOT NULL, started_at TEXT, ended_at TEXT, summary TEXT, failure TEXT, source TEXT,
    requested_by TEXT, kept INTEGER NOT NULL DEFAULT 0, calibration_sha256 TEXT, inputs TEXT, files TEXT,
    simulated INTEGER, timing TEXT, views
);
CREATE INDEX scans_of ON scans (recording);
CREATE INDEX scans_again ON scans (source);
CREATE INDEX scans_in ON scans (state, id);
CREATE TABLE views (
    scan TEXT NOT NULL REFERENCES scans (id), view INTEGER NOT NULL, state TEXT NOT NULL, reason TEXT,
    changed_at TEXT NOT NULL, offset_bytes BIGINT, size_bytes BIGINT, sha256 TEXT, move_s DOUBLE PRECISION,
    settle_s DOUBLE PRECISION, exposure_s DOUBLE PRECISION, PRIMARY KEY (scan, view)
);
CREATE TABLE scan_errors (
    scan TEXT PRIMARY KEY, calibration_sha256 TEXT NOT NULL, likeliest TEXT NOT NULL, information TEXT NOT NULL,
    vector TEXT NOT NULL
);
CREATE INDEX scan_errors_of ON scan_errors (calibration_sha256, scan);
CREATE TABLE calibrations (
    id TEXT PRIMARY KEY, kind TEXT NOT NULL, board TEXT, poses INTEGER NOT NULL, warnings TEXT NOT NULL,
    calibration_sha256 TEXT, state TEXT NOT NULL, stage TEXT, fraction DOUBLE PRECISION NOT NULL,
    coverage DOUBLE PRECISION NOT NULL, created_at TEXT NOT NULL, started_at TEXT, ended_at TEXT, activated_at TEXT,
    result TEXT, verification TEXT, failure TEXT
);
CREATE TABLE calibration_views (
    calibration TEXT NOT NULL REFERENCES calibrations (id), view INTEGER NOT NULL, state TEXT NOT NULL, reason TEXT,
    corners INTEGER, board_corners INTEGER, changed_at TEXT NOT NULL, rms_px DOUBLE PRECISION, cells TEXT,
    PRIMARY KEY (calibration, view)
);
CREATE TABLE idempotency_keys (
    caller TEXT NOT NULL, idempotency_key TEXT NOT NULL, body_sha256 TEXT NOT NULL,
    scan TEXT NOT NULL REFERENCES scans (id), created_at TEXT NOT NULL, PRIMARY KEY (caller, idempotency_key)
);
CREATE INDEX idempotency_keys_of ON idempotency_keys (scan);
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, scan TEXT NOT NULL REFERENCES scans (id), at TEXT NOT NULL,
    kind TEXT NOT NULL, data TEXT NOT NULL
);
CREATE INDEX events_of ON events (scan, id);
CREATE TABLE cell_fault (
    id INTEGER PRIMARY KEY CHECK (id = 1), slug TEXT NOT NULL, reason TEXT NOT NULL, at TEXT NOT NULL
);
CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT, at TEXT NOT NULL, who TEXT NOT NULL, role TEXT NOT NULL, what TEXT NOT NULL,
    scan TEXT, cell TEXT NOT NULL, status INTEGER NOT NULL, result TEXT
);
CREATE TRIGGER audit_is_not_changed BEFORE UPDATE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever added to'); END;
CREATE TRIGGER audit_is_not_deleted BEFORE DELETE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever added to'); END;
""",
)
"""One script for each version. The first creates the tables, and each of the others migrates them from the version
before. The database's `user_version` is the number of scripts applied. The column `views` of `scans` has no type,
because it is a number or text.
"""


def latest_version() -> int:
    """Return the version of the tables that this release uses."""
    return len(MIGRATIONS)


def has_unknown_layout(db: sqlite3.Connection) -> bool:
    """Return whether a database has tables, and no release of Pointchain made them."""
    (application_id,) = db.execute("PRAGMA application_id").fetchone()
    (tables,) = db.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return tables > 0 and application_id != APPLICATION_ID


def migrate(db: sqlite3.Connection, version: int | None = None) -> None:
    """Create the tables of a version, or migrate those of an earlier one. The caller holds the transaction.

    Args:
        db: Connection to a database without tables, or with tables of an earlier version.
        version: Version of the tables. None: the latest.
    """
    version = latest_version() if version is None else version
    (present,) = db.execute("PRAGMA user_version").fetchone()
    for migration in MIGRATIONS[present:version]:
        for statement in _statements(migration):
            db.execute(statement)
    db.execute(f"PRAGMA user_version = {version}")
    db.execute(f"PRAGMA application_id = {APPLICATION_ID}")


def _statements(script: str) -> Iterator[str]:
    """Split a script: `executescript` would end the transaction. The body of a trigger contains semicolons."""
    statement = ""
    for line in script.splitlines(keepends=True):
        statement += line
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""
