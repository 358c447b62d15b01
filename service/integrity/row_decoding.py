"""Decoding of database rows, checked as far as the service needs to return them.

A row that the service cannot return makes every list fail that contains it.
"""

import reprlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from service.api.schemas.calibration_resources import run_resource
from service.api.schemas.recording_resource import recording_resource
from service.api.schemas.scan_resource import scan_resource
from service.storage.data_folder import ID
from service.storage.rows import (
    CalibrationRow,
    CalibrationViewRow,
    RecordingRow,
    ScanRow,
    ViewRow,
    to_calibration,
    to_calibration_view,
    to_recording,
    to_scan,
)


class UnreadableRowError(ValueError):
    """The service cannot return this row. The message gives the reason, in one line."""


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    sha256: str
    size_bytes: int


_FILES: TypeAdapter[dict[str, _File]] = TypeAdapter(dict[str, _File])


def decode_recording(values: dict[str, Any]) -> RecordingRow:
    """Return the recording of these columns.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    with _unreadable_on_error(values):
        row = to_recording(values)  # pyright: ignore[reportArgumentType] (is read by column names, like a sqlite3.Row)
        _require_id(row.id)
        recording_resource(row)
        return row


def decode_scan(values: dict[str, Any]) -> ScanRow:
    """Return the scan of these columns.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    with _unreadable_on_error(values):
        row = to_scan(values)  # pyright: ignore[reportArgumentType]
        _require_id(row.id)
        scan_resource(row, [])
        if row.files is not None:
            _FILES.validate_python(row.files)
        return row


def decode_view(values: dict[str, Any], scan_of: Callable[[str], ScanRow | None]) -> ViewRow:
    """Return the view of these columns.

    Args:
        values: Columns of the row.
        scan_of: Returns the scan with an id; None if it cannot be read.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    with _unreadable_on_error(values):
        row = ViewRow(**values)
        _require_id(row.scan)
        for name in ("offset_bytes", "size_bytes"):
            if not isinstance(values[name], int | None):
                raise ValueError(f"{name} is {reprlib.repr(values[name])}, which is not a number")
        if (scan := scan_of(row.scan)) is not None:
            scan_resource(scan, [row])
        return row


def decode_calibration(values: dict[str, Any]) -> CalibrationRow:
    """Return the calibration of these columns.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    with _unreadable_on_error(values):
        row = to_calibration(values)  # pyright: ignore[reportArgumentType]
        _require_id(row.id)
        run_resource(row, [])
        return row


def decode_calibration_view(
    values: dict[str, Any], calibration_of: Callable[[str], CalibrationRow | None]
) -> CalibrationViewRow:
    """Return the calibration view of these columns.

    Args:
        values: Columns of the row.
        calibration_of: Returns the calibration with an id; None if it cannot be read.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    with _unreadable_on_error(values):
        row = to_calibration_view(values)  # pyright: ignore[reportArgumentType]
        if (calibration := calibration_of(row.calibration)) is not None:
            run_resource(calibration, [row])
        return row


@contextmanager
def _unreadable_on_error(values: dict[str, Any]) -> Iterator[None]:
    """Turn every error of the decoding into an UnreadableRowError with a message of one line."""
    try:
        for name, value in values.items():
            if isinstance(value, bytes):  # SQLite accepts any bytes in a text column
                raise ValueError(f"{name} is {reprlib.repr(value)}, which is not text")
        yield
    except ValidationError as error:
        raise UnreadableRowError("; ".join(map(_describe, error.errors(include_url=False)))) from error
    except KeyError as error:
        raise UnreadableRowError(f"it has no {error}") from error
    except (ValueError, TypeError) as error:
        raise UnreadableRowError(str(error)) from error


def _describe(error: Any) -> str:
    where = ".".join(map(str, error["loc"])) or "it"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg']}"


def _require_id(row_id: object) -> None:
    """Raise ValueError for an id that the service did not make: no file may be opened by it."""
    if not isinstance(row_id, str) or not ID.fullmatch(row_id):
        raise ValueError(f"{reprlib.repr(row_id)} is not an id")
