"""File formats of the output: JSON lines, or a Parquet table with one row per line."""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder
from service.batch.errors import INSTALL_EXTRA, BatchError

PARQUET = ".parquet"
SUFFIXES = (".jsonl", PARQUET)
ROWS_PER_GROUP = 200
"""Rows in memory at a time. A model has about ten kilobytes."""


def read_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file that `write_lines` wrote or `pointchain recognise` printed.

    Raises:
        BatchError: The file has another format.
        OSError: The file cannot be read.
    """
    if path.suffix == PARQUET:
        yield from _parquet_lines(path)
        return
    with path.open(encoding="utf-8") as file:
        try:
            yield from (line.rstrip("\n") for line in file)
        except UnicodeDecodeError as error:
            raise BatchError(f"{path} is not a file of JSON lines: {error}") from error


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a file, or replace an existing one in one step. It is on the disk when this returns.

    Args:
        path: File. Its suffix selects the format.
        lines: JSON documents without line breaks.

    Raises:
        BatchError: The packages for Parquet are missing.
        OSError: The file cannot be written. An existing file is unchanged.
    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        if path.suffix == PARQUET:
            _write_parquet(fresh, iter(lines))
        else:
            with fresh.open("w", encoding="utf-8") as file:
                file.writelines(f"{line}\n" for line in lines)
        with fresh.open("rb+") as file:
            os.fsync(file.fileno())
        fresh.replace(path)
    except BaseException:
        with suppress(OSError):
            fresh.unlink()
        raise
    sync_folder(path.parent)


def require_parquet() -> None:
    """Check that the packages for Parquet are installed, before hours of work rather than after.

    Raises:
        BatchError: A package is missing.
    """
    try:
        import pyarrow.parquet  # noqa: F401 -- checks only whether it is installed
    except ImportError as error:
        raise BatchError(f"Parquet needs the extra `archive`: {INSTALL_EXTRA}") from error


def _write_parquet(path: Path, lines: Iterator[str]) -> None:
    require_parquet()
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema(
        [
            pa.field("file", pa.string()),
            pa.field("sha256", pa.string()),
            pa.field("method", pa.string()),
            pa.field("error", pa.string()),
            pa.field("detail", pa.string()),
            pa.field("chains", pa.int32()),
            pa.field("length_m", pa.float64()),
            pa.field("crossings", pa.int32()),
            pa.field("grasps", pa.int32()),
            pa.field("verdict", pa.string()),
            pa.field("doubts", pa.list_(pa.string())),
            pa.field("notes", pa.list_(pa.string())),
            pa.field("document", pa.string()),
        ]
    )
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        while rows := [_row(line) for line in islice(lines, ROWS_PER_GROUP)]:
            writer.write_table(pa.Table.from_pylist(rows, schema))


def _row(line: str) -> dict[str, Any]:
    """Return the columns of a line, with the values that are needed most. Without a model they are None."""
    document = json.loads(line)
    recording, method = document["recording"], document["request"]["method"]
    row = {"file": _utf8(recording["file"]), "sha256": recording["sha256"], "method": method, "document": line}
    if "error" in document:
        error = document["error"]
        return row | {"error": error["type"].removeprefix("urn:pointchain:"), "detail": _utf8(error["detail"])}
    return row | {
        "chains": len(document["chains"]),
        "length_m": sum(chain["length_m"] for chain in document["chains"]),
        "crossings": len(document["crossings"]),
        "grasps": len(document["grasps"]),
        "verdict": document["quality"]["verdict"],
        "doubts": [found["code"] for found in document["quality"]["findings"] if found["severity"] != "note"],
        "notes": [found["code"] for found in document["quality"]["findings"] if found["severity"] == "note"],
    }


def _utf8(text: str) -> str:
    """Escape bytes that are not valid text, which file names and messages about them may hold. Parquet rejects them."""
    return text.encode("utf-8", "backslashreplace").decode()


def _parquet_lines(path: Path) -> Iterator[str]:
    require_parquet()
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as table:
            for batch in table.iter_batches(ROWS_PER_GROUP, columns=["document"]):
                yield from batch.column(0).to_pylist()
    except (pa.ArrowInvalid, KeyError, IndexError) as error:
        raise BatchError(f"{path} is not the output of pointchain recognise: {error}") from error
