"""`pointchain recognise`: recordings in, one JSON document a line out."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from recognition.gripper import Gripper
from recognition.model import SCHEMA, Method
from recognition.pipeline import stages_of
from service.problems import INPUT_ERRORS, problem_document
from service.trace import write_trace
from service.workflow import recognise_recording


def recognise_files(
    files: Sequence[Path], radius_m: float | None, method: Method, trace: Path | None, gripper: Gripper
) -> int:
    """Recognises each file; prints its model, or `{"schema", "error"}`, on a line of its own on stdout.

    A progress bar goes to stderr when that is a terminal. Returns 1 when a file failed, else 0.
    """
    from tqdm import tqdm

    failed, stages = 0, len(stages_of(method))
    with tqdm(total=len(files) * stages, unit="stage", disable=not sys.stderr.isatty()) as bar:
        for number, file in enumerate(files, 1):
            bar.set_description(file.name)
            document, reason = _recognise_file(file, radius_m, method, trace, gripper, bar.set_postfix_str)
            bar.update(number * stages - bar.n)
            print(json.dumps(document, allow_nan=False), flush=True)
            if reason is not None:
                failed += 1
                bar.write(f"pointchain recognise: {file}: {reason}", file=sys.stderr)
    return 1 if failed else 0


def _recognise_file(
    file: Path, radius_m: float | None, method: Method, trace: Path | None, gripper: Gripper, on_stage: Any
) -> tuple[dict[str, Any], str | None]:
    """The file's document, and why it failed if it did."""
    try:
        recognition = recognise_recording(file, radius_m, method, on_stage, gripper)
        if trace is not None:
            write_trace(recognition, trace / file.stem, truth_beside(file))
    except INPUT_ERRORS as error:
        slug, reason = error.slug, str(error)
    except OSError as error:
        slug, reason = "file", f"{error.filename or file}: {error.strerror or error}"
    else:
        return recognition.model.to_json(), None
    return {"schema": SCHEMA, "error": problem_document(422, slug, reason, file=str(file))}, reason


def truth_beside(recording: Path) -> dict[str, Any] | None:
    """The truth file of a simulated recording, None where there is none."""
    path = recording.with_suffix(".truth.json")
    return json.loads(path.read_bytes()) if path.is_file() else None
