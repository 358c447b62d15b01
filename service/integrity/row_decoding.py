"""Decoding of database rows, checked as far as the service needs to return them.

A row that the service cannot return makes every list fail that contains it.
"""

import reprlib
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from service.api.schemas.calibration_resources import run_resource
from service.api.schemas.recording_resource import recording_resource
from service.api.schemas.scan_resource import scan_resource
from service.storage.data_folder import ID
from service.storage.rows import (
    CalibrationRow,
    Row,
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


def decode_row(table: str, values: dict[str, Any], parent: Row | None = None) -> Row:
    """Return the row of these columns.

    Args:
        table: `recordings`, `scans`, `views`, `calibrations` or `calibration_views`.
        values: Columns of the row.
        parent: Scan or calibration of a view. None: it cannot be read, or there is none.

    Raises:
        UnreadableRowError: A column is missing or invalid.
    """
    try:
        for name, value in values.items():
            if isinstance(value, bytes):  # SQLite accepts any bytes in a text column
                raise ValueError(f"{name} is {reprlib.repr(value)}, which is not text")
        row, row_id = _decode(table, values, parent)
        if not isinstance(row_id, str) or not ID.fullmatch(row_id):  # no file may be opened by it
            raise ValueError(f"{reprlib.repr(row_id)} is not an id")
        return row
    except ValidationError as error:
        raise UnreadableRowError("; ".join(map(_describe, error.errors(include_url=False)))) from error
    except KeyError as error:
        raise UnreadableRowError(f"it has no {error}") from error
    except (ValueError, TypeError) as error:
        raise UnreadableRowError(str(error)) from error


def _decode(table: str, values: Any, parent: Row | None) -> tuple[Row, object]:
    """Return a row and the id by which its files are opened. The columns are read by name, as in a sqlite3.Row."""
    match table:
        case "recordings":
            row = to_recording(values)
            recording_resource(row)
        case "scans":
            row = to_scan(values)
            scan_resource(row, [])
            if row.files is not None:
                _FILES.validate_python(row.files)
        case "views":
            view = ViewRow(**values)
            for name in ("offset_bytes", "size_bytes"):
                if not isinstance(values[name], int | None):
                    raise ValueError(f"{name} is {reprlib.repr(values[name])}, which is not a number")
            if isinstance(parent, ScanRow):
                scan_resource(parent, [view])
            return view, view.scan
        case "calibrations":
            row = to_calibration(values)
            run_resource(row, [])
        case _:
            view = to_calibration_view(values)
            if isinstance(parent, CalibrationRow):
                run_resource(parent, [view])
            return view, view.calibration
    return row, row.id


def _describe(error: Any) -> str:
    where = ".".join(map(str, error["loc"])) or "it"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg']}"
