"""`pointchain export`: a model as a file of another kind, which the name's ending tells."""

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

KINDS: Mapping[str, Write] = {
    ".ply": lambda path, model: write_synced(path, to_point_ply(model)),
    ".csv": lambda path, model: write_synced(path, to_csv(model)),
    ".mcap": write_result_file,
}
"""By the file's ending."""


def export(model: Path, out: Path) -> int:
    """Exports the model in the file `model` to the new file `out`; the exit code."""
    try:
        if out.suffix.lower() not in KINDS:
            raise ExportError(f"{out} ends in none of {', '.join(KINDS)}, by which it is known what to write")
        if out.exists():
            raise ExportError(f"{out} exists already; nothing is overwritten: choose another name")
        document = read_model(model)
        _write(out, KINDS[out.suffix.lower()], document)
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
    """Under another name first, then renamed: it is complete or not there."""
    unfinished = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        write(unfinished, document)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(out.parent)
