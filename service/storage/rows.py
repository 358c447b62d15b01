"""Rows of the database tables as values."""

import json
import sqlite3
from dataclasses import dataclass
from typing import Any, Literal

from cell.config.scan_views import Views
from recognition.request import RecognitionRequest
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
    """File name at the upload; None if it was not given or a live scan made the recording."""
    simulated: bool | None = None
    """Whether the arm or the camera was simulated; None if not known."""


@dataclass(frozen=True)
class ScanRow:
    """A scan as last written."""

    id: str
    mode: Literal["replay", "live"]
    recording: str | None
    request: RecognitionRequest
    """How to recognise it."""
    state: ScanState
    stage: str | None
    fraction: float
    created_at: str
    started_at: str | None
    ended_at: str | None
    summary: dict[str, Any] | None
    failure: Failure | None
    source: str | None = None
    """Id of the scan that this one reprocesses."""
    requested_by: str | None = None
    """Name of the token of the requester; None if no token was needed."""
    kept: bool = False
    """A person marked the scan to be kept."""
    calibration_sha256: str | None = None
    """Hash of the hand-eye calibration with which a live scan was planned."""
    inputs: dict[str, Any] | None = None
    """Inputs of recognition, as JSON."""
    files: dict[str, Any] | None = None
    """SHA-256 and size of each file of the result, by name."""
    simulated: bool | None = None
    """Whether the arm or the camera is simulated; None if not known."""
    timing: dict[str, Any] | None = None
    """Durations of the parts of the scan apart from its views, seconds, as JSON."""
    views: Views | None = None
    """Number of viewpoints of a live scan, or `auto`; None for a replay."""


@dataclass(frozen=True)
class ViewRow:
    """A view of a live scan as last written."""

    scan: str
    view: int
    state: ViewState
    reason: str | None
    changed_at: str
    offset_bytes: int | None = None
    """Offset of the view in its recording."""
    size_bytes: int | None = None
    """Size of the view in its recording."""
    sha256: str | None = None
    """Hash of these bytes."""
    move_s: float | None = None
    """Duration of the move to the viewpoint, seconds."""
    settle_s: float | None = None
    """Duration of the wait at the viewpoint, seconds."""
    exposure_s: float | None = None
    """Duration of the exposures, seconds."""


@dataclass(frozen=True)
class KeyRow:
    """An idempotency key, and the scan that it started."""

    caller: str
    idempotency_key: str
    body_sha256: str
    scan: str
    created_at: str


@dataclass(frozen=True)
class CalibrationRow:
    """A calibration run or a verification as last written."""

    id: str
    kind: Literal["calibration", "verification"]
    board: dict[str, Any] | None
    """Board as `Board.to_json` writes it; None for the board of the active calibration."""
    poses: int
    warnings: list[str]
    """Warnings of the plan."""
    calibration_sha256: str | None
    """Hash of the calibration that is verified."""
    state: ScanState
    stage: str | None
    fraction: float
    coverage: float
    """Fraction of the image in which corners were detected."""
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
    changed_at: str
    corners: int | None = None
    """Number of corners detected in its image; None if the image was not processed yet."""
    board_corners: int | None = None
    """Number of corners of the board."""
    rms_px: float | None = None
    """RMS distance of the corners from the fitted board, pixels, each coordinate."""
    cells: list[int] | None = None
    """Cells of the image that contain corners; None if the image was not processed yet."""


@dataclass(frozen=True)
class ScanErrorRow:
    """The hand-eye error that a live scan estimates. It stays when the scan is removed.

    The values are those of `recognition.registration.hand_eye_error.HandEyeErrorEstimate`.
    """

    scan: str
    calibration_sha256: str
    likeliest: list[float]
    information: list[list[float]]
    vector: list[float]


Row = RecordingRow | ScanRow | ViewRow | KeyRow | CalibrationRow | CalibrationViewRow | ScanErrorRow


def stored(value: Any) -> Any:
    """Return a value as its column stores it."""
    if isinstance(value, Failure):
        value = vars(value)
    if isinstance(value, RecognitionRequest):
        value = value.to_json()
    return json.dumps(value, allow_nan=False) if isinstance(value, dict | list | tuple) else value


def insert(db: sqlite3.Connection, table: str, row: Row) -> None:
    """Insert a row."""
    values = vars(row)
    sql = f"INSERT INTO {table} ({', '.join(values)}) VALUES ({', '.join('?' * len(values))})"
    db.execute(sql, [stored(value) for value in values.values()])


def to_recording(row: sqlite3.Row) -> RecordingRow:
    """Convert a row of `recordings`."""
    values = _parsed(row, "missing", "provenance")
    values["simulated"] = _flag(values["simulated"])
    return RecordingRow(**values)


def to_scan(row: sqlite3.Row) -> ScanRow:
    """Convert a row of `scans`."""
    values = _parsed(row, "request", "summary", "failure", "inputs", "files", "timing")
    values["kept"] = bool(values["kept"])
    values["request"] = RecognitionRequest.from_json(values["request"])
    values["simulated"] = _flag(values["simulated"])
    return ScanRow(**values)


def _flag(value: int | None) -> bool | None:
    return None if value is None else bool(value)


def to_calibration(row: sqlite3.Row) -> CalibrationRow:
    """Convert a row of `calibrations`."""
    return CalibrationRow(**_parsed(row, "board", "warnings", "result", "verification", "failure"))


def to_calibration_view(row: sqlite3.Row) -> CalibrationViewRow:
    """Convert a row of `calibration_views`."""
    return CalibrationViewRow(**_parsed(row, "cells"))


def to_scan_error(row: sqlite3.Row) -> ScanErrorRow:
    """Convert a row of `scan_errors`."""
    return ScanErrorRow(**_parsed(row, "likeliest", "information", "vector"))


def _parsed(row: sqlite3.Row, *documents: str) -> dict[str, Any]:
    """Return the columns of a row, with the named ones parsed from JSON."""
    values: dict[str, Any] = dict(row)
    parsed = {name: json.loads(values[name]) if values[name] else None for name in documents}
    failure: dict[str, Any] | None = parsed.get("failure")
    return values | parsed | ({} if failure is None else {"failure": Failure(**failure)})
