"""The rows of the database's tables as values."""

import json
import sqlite3
from dataclasses import dataclass
from typing import Any, Literal

from recognition.model.model import Method
from service.errors import Failure
from service.states import ScanState, ViewState


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
    name: str | None = None
    """What it was called by who sent it."""


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
    failure: Failure | None
    source: str | None = None
    """The scan that it does again from its recording."""
    asked_by: str | None = None
    """Name of the token that it was started with; None: nobody had to say who he is."""
    kept: bool = False
    """A person wants it kept for ever."""
    calibration_sha256: str | None = None
    """Of the hand-eye calibration that a live scan was accepted with."""
    inputs: dict[str, Any] | None = None
    """What recognition was begun with."""
    files: dict[str, Any] | None = None
    """The result's files: name to SHA-256 and size."""


@dataclass(frozen=True)
class ViewRow:
    """A viewpoint of a live scan as last written."""

    scan: str
    view: int
    state: ViewState
    reason: str | None
    changed_at: str
    offset_bytes: int | None = None
    """Where the view begins in its recording ..."""
    size_bytes: int | None = None
    """... how many bytes it has there ..."""
    sha256: str | None = None
    """... and their hash."""


@dataclass(frozen=True)
class KeyRow:
    """An idempotency key, and what it was used for."""

    caller: str
    idempotency_key: str
    body_sha256: str
    scan: str
    created_at: str


@dataclass(frozen=True)
class CalibrationRow:
    """A calibration by the cell, or the verification of one, as last written."""

    id: str
    kind: Literal["calibration", "verification"]
    board: dict[str, Any] | None
    """As `Board.to_json` has it; None: the one that the calibration in use was made with."""
    poses: int
    warnings: list[str]
    """What the plan of its poses lacks, in words."""
    calibration_sha256: str | None
    """Of the calibration that a verification is of."""
    state: ScanState
    stage: str | None
    fraction: float
    coverage: float
    """Share of the image in which corners were seen."""
    created_at: str
    started_at: str | None
    ended_at: str | None
    activated_at: str | None
    result: dict[str, Any] | None
    verification: dict[str, Any] | None
    failure: Failure | None


@dataclass(frozen=True)
class CalibrationViewRow:
    """A view of a calibration as last written."""

    calibration: str
    view: int
    state: ViewState
    reason: str | None
    corners: int | None
    """Found in its picture; None: not looked for yet."""
    possible: int | None
    changed_at: str
    rms_px: float | None = None
    """How far they are from where a board would have them."""
    cells: list[int] | None = None
    """Parts of the picture in which they are; None: not looked for yet."""


@dataclass(frozen=True)
class ScanErrorRow:
    """What a live scan told of the error of the calibration that it was made with; the numbers are those of
    `recognition.registration.hand_eye_error.HandEyeErrorEstimate`. It outlasts the scan."""

    scan: str
    calibration_sha256: str
    likeliest: list[float]
    information: list[list[float]]
    vector: list[float]


Row = RecordingRow | ScanRow | ViewRow | KeyRow | CalibrationRow | CalibrationViewRow | ScanErrorRow


def stored(value: Any) -> Any:
    """A value as its column takes it."""
    if isinstance(value, Failure):
        value = vars(value)
    return json.dumps(value, allow_nan=False) if isinstance(value, dict | list | tuple) else value


def insert(db: sqlite3.Connection, table: str, row: Row) -> None:
    """Writes a new row."""
    values = vars(row)
    sql = f"INSERT INTO {table} ({', '.join(values)}) VALUES ({', '.join('?' * len(values))})"
    db.execute(sql, [stored(value) for value in values.values()])


def to_recording(row: sqlite3.Row) -> RecordingRow:
    """A row of `recordings`."""
    return RecordingRow(**_parsed(row, "missing", "provenance"))


def to_scan(row: sqlite3.Row) -> ScanRow:
    """A row of `scans`."""
    values = _parsed(row, "summary", "failure", "inputs", "files")
    values["kept"] = bool(values["kept"])
    return ScanRow(**values)


def to_calibration(row: sqlite3.Row) -> CalibrationRow:
    """A row of `calibrations`."""
    return CalibrationRow(**_parsed(row, "board", "warnings", "result", "verification", "failure"))


def to_calibration_view(row: sqlite3.Row) -> CalibrationViewRow:
    """A row of `calibration_views`."""
    return CalibrationViewRow(**_parsed(row, "cells"))


def to_scan_error(row: sqlite3.Row) -> ScanErrorRow:
    """A row of `scan_errors`."""
    return ScanErrorRow(**_parsed(row, "likeliest", "information", "vector"))


def _parsed(row: sqlite3.Row, *documents: str) -> dict[str, Any]:
    """The row's columns, those named from their JSON."""
    values: dict[str, Any] = dict(row)
    parsed = {name: json.loads(values[name]) if values[name] else None for name in documents}
    failure: dict[str, Any] | None = parsed.get("failure")
    return values | parsed | ({} if failure is None else {"failure": Failure(**failure)})
