"""Rows as the service would tell them: one that it cannot tell is an error in every list that has it."""

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
    """A row that the service cannot tell; the message says why, in one line."""


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    sha256: str
    size_bytes: int


_FILES: TypeAdapter[dict[str, _File]] = TypeAdapter(dict[str, _File])


def readable_recording(values: dict[str, Any]) -> RecordingRow:
    """The row of these columns. Raises UnreadableRowError."""
    with _told(values):
        row = to_recording(values)  # pyright: ignore[reportArgumentType] (by its columns' names, as of a sqlite3.Row)
        _require_id(row.id)
        recording_resource(row)
        return row


def readable_scan(values: dict[str, Any]) -> ScanRow:
    """The row of these columns. Raises UnreadableRowError."""
    with _told(values):
        row = to_scan(values)  # pyright: ignore[reportArgumentType]
        _require_id(row.id)
        scan_resource(row, [])
        if row.files is not None:
            _FILES.validate_python(row.files)
        return row


def readable_view(values: dict[str, Any], of: Callable[[str], ScanRow | None]) -> ViewRow:
    """The row of these columns; `of` gives its scan, if that can be read. Raises UnreadableRowError."""
    with _told(values):
        row = ViewRow(**values)
        _require_id(row.scan)
        for name in ("offset_bytes", "size_bytes"):
            if not isinstance(values[name], int | None):
                raise ValueError(f"{name} is {reprlib.repr(values[name])}: it is no number")
        if (scan := of(row.scan)) is not None:
            scan_resource(scan, [row])
        return row


def readable_calibration(values: dict[str, Any]) -> CalibrationRow:
    """The row of these columns. Raises UnreadableRowError."""
    with _told(values):
        row = to_calibration(values)  # pyright: ignore[reportArgumentType]
        _require_id(row.id)
        run_resource(row, [])
        return row


def readable_calibration_view(values: dict[str, Any], of: Callable[[str], CalibrationRow | None]) -> CalibrationViewRow:
    """The row of these columns; `of` gives its calibration, if that can be read. Raises UnreadableRowError."""
    with _told(values):
        row = to_calibration_view(values)  # pyright: ignore[reportArgumentType]
        if (calibration := of(row.calibration)) is not None:
            run_resource(calibration, [row])
        return row


@contextmanager
def _told(values: dict[str, Any]) -> Iterator[None]:
    """What making a row and its resource raises, as one error in one line."""
    try:
        for name, value in values.items():
            if isinstance(value, bytes):  # SQLite itself takes anything
                raise ValueError(f"{name} is {reprlib.repr(value)}: it is no text")
        yield
    except ValidationError as error:
        raise UnreadableRowError("; ".join(map(_words, error.errors(include_url=False)))) from error
    except KeyError as error:
        raise UnreadableRowError(f"it has no {error}") from error
    except (ValueError, TypeError) as error:
        raise UnreadableRowError(str(error)) from error


def _words(error: Any) -> str:
    where = ".".join(map(str, error["loc"])) or "it"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg']}"


def _require_id(row_id: object) -> None:
    """Raises ValueError: it is none of ours, so that nothing may be looked for by it."""
    if not isinstance(row_id, str) or not ID.fullmatch(row_id):
        raise ValueError(f"{reprlib.repr(row_id)} is not an id")
