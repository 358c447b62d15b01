"""The database's tables, and their rows as values."""

import json
import sqlite3
from dataclasses import dataclass
from typing import Any, Literal

from recognition.model import Method
from service.schemas import ScanState, ViewState

MIGRATIONS = (
    """
CREATE TABLE recordings (
    id TEXT PRIMARY KEY, created_at TEXT NOT NULL, size_bytes BIGINT NOT NULL, sha256 TEXT NOT NULL,
    views INTEGER NOT NULL, missing TEXT NOT NULL, string_radius_m DOUBLE PRECISION,
    table_z_m DOUBLE PRECISION NOT NULL, provenance TEXT NOT NULL
);
CREATE TABLE scans (
    id TEXT PRIMARY KEY, mode TEXT NOT NULL, recording TEXT REFERENCES recordings (id), method TEXT NOT NULL,
    string_radius_m DOUBLE PRECISION, state TEXT NOT NULL, stage TEXT, fraction DOUBLE PRECISION NOT NULL,
    created_at TEXT NOT NULL, started_at TEXT, ended_at TEXT, summary TEXT, problem TEXT
);
""",
    """
CREATE TABLE views (
    scan TEXT NOT NULL REFERENCES scans (id), view INTEGER NOT NULL, state TEXT NOT NULL, reason TEXT,
    changed_at TEXT NOT NULL, PRIMARY KEY (scan, view)
);
""",
)
"""What makes the tables, and what later versions added: the database's user_version tells how many of these it has."""
VERSION = len(MIGRATIONS)


@dataclass(frozen=True)
class RecordingRow:
    """A stored recording."""

    id: str
    created_at: str
    size_bytes: int
    sha256: str
    views: int
    missing: list[str]
    string_radius_m: float | None
    table_z_m: float
    provenance: dict[str, str]


@dataclass(frozen=True)
class ScanRow:
    """A scan as last written."""

    id: str
    mode: Literal["replay", "live"]
    recording: str | None
    method: Method
    string_radius_m: float | None
    state: ScanState
    stage: str | None
    fraction: float
    created_at: str
    started_at: str | None
    ended_at: str | None
    summary: dict[str, Any] | None
    problem: dict[str, Any] | None


@dataclass(frozen=True)
class ViewRow:
    """A viewpoint of a live scan as last written."""

    scan: str
    view: int
    state: ViewState
    reason: str | None
    changed_at: str


def stored(value: Any) -> Any:
    """A value as its column takes it."""
    return json.dumps(value, allow_nan=False) if isinstance(value, dict | list) else value


def insert(db: sqlite3.Connection, table: str, row: RecordingRow | ScanRow | ViewRow) -> None:
    """Writes a new row."""
    values = vars(row)
    sql = f"INSERT INTO {table} ({', '.join(values)}) VALUES ({', '.join('?' * len(values))})"
    db.execute(sql, [stored(value) for value in values.values()])


def to_recording(row: sqlite3.Row) -> RecordingRow:
    """A row of `recordings`."""
    values: dict[str, Any] = dict(row)
    return RecordingRow(**values | {name: json.loads(values[name]) for name in ("missing", "provenance")})


def to_scan(row: sqlite3.Row) -> ScanRow:
    """A row of `scans`."""
    values: dict[str, Any] = dict(row)
    for name in ("summary", "problem"):
        values[name] = json.loads(values[name]) if values[name] else None
    return ScanRow(**values)
