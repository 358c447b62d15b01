"""`pointchain export`: write a model in another format, which the suffix of the file selects."""

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from calibration.atomic_write import sync_folder, write_synced
from cell.recording.errors import RecordingError
from cell.recording.result_file import write_result_file
from service.interchange.errors import ExportError
from service.interchange.model_file import read_model
from service.interchange.point_files import to_csv, to_point_ply

Write = Callable[[Path, Mapping[str, Any]], None]

WRITERS: Mapping[str, Write] = {
    ".ply": lambda path, model: write_synced(path, to_point_ply(model)),
    ".csv": lambda path, model: write_synced(path, to_csv(model)),
    ".mcap": write_result_file,
}
"""Functions that write a model, by the suffix of the file."""


def export(model: Path, out: Path) -> int:
    """Export a model to a new file and return the exit code.

    Args:
        model: File with the model; `-` is stdin.
        out: File to write.
    """
    try:
        if out.suffix.lower() not in WRITERS:
            raise ExportError(f"{out} has no known format: choose a name that ends in one of {', '.join(WRITERS)}")
        if out.exists():
            raise ExportError(f"{out} exists already; nothing is overwritten: choose another name")
        document = read_model(model)
        _write(out, WRITERS[out.suffix.lower()], document)
    except (ExportError, RecordingError) as error:
        print(f"pointchain export: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain export: {out} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    points = sum(len(chain["points"]) for chain in document["chains"])
    print(f"wrote {out}: {len(document['chains'])} chains, {points} points", file=sys.stderr)
    return 0


def _write(out: Path, write: Write, document: Mapping[str, Any]) -> None:
    """Write under another name, then rename, so that the file is complete or does not exist."""
    unfinished = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        write(unfinished, document)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(out.parent)
