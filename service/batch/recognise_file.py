"""Recognition of one recording to one line of output, which holds the model or the error."""

import json
import sys
import traceback
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from recognition.model.model import SCHEMA, PointChainModel
from recognition.request import RecognitionRequest
from recognition.result import Recognition
from service.errors import INPUT_ERRORS
from service.problems.document import error_document
from service.processing.recording_metadata import hash_file
from service.processing.results import OnStage, Source, recognise_recording
from service.processing.stage_figures import write_trace


@dataclass(frozen=True)
class RecordingLine:
    """Output for one recording."""

    file: str
    """Name of the recording, as given by the caller."""
    text: str
    """One JSON document without line breaks, with `recording`, `request`, and the model or `schema` and `error`."""
    reason: str | None = None
    """Reason why there is no model. None: there is one."""
    notes: tuple[str, ...] = ()
    """Messages about the verdict, the doubts, the views that the model does not use, and what the recording lacks."""


def release() -> str:
    """Return the version of Pointchain in this process."""
    return version("pointchain")


def request_document(request: RecognitionRequest) -> dict[str, Any]:
    """Return the member `request` of a line: the request, and the version of Pointchain that recognises."""
    return request.to_json() | {"version": release()}


def recognise_file(
    file: str,
    request: RecognitionRequest,
    trace: Path | None = None,
    on_stage: OnStage | None = None,
    path: Path | None = None,
) -> RecordingLine:
    """Recognise a recording. Errors become a line too, so that one file cannot end the run.

    Args:
        file: Name of the recording, for the line.
        request: How to recognise it.
        trace: Folder for pictures of every stage. None: no pictures.
        on_stage: Called with the name of each stage.
        path: The file, if its name is not `file`.
    """
    path = Path(file) if path is None else path
    sha256 = hash_recording(path)
    try:
        recognition = recognise_recording(path, request, on_stage, Source(recording_sha256=sha256))
        line = replace(_line(file, request, recognition.model.to_json(), sha256), notes=_notes(recognition.model))
    except INPUT_ERRORS as error:
        return failed_line(file, request, error.slug, str(error), sha256)
    except OSError as error:
        return failed_line(file, request, "file", f"{error.filename or file}: {error.strerror or error}", sha256)
    except BaseException as error:  # a panic of native code is not an Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            raise
        traceback.print_exc(file=sys.stderr)  # an error in Pointchain needs the whole traceback
        return failed_line(file, request, "internal", f"unexpected error, please report it: {error!r}", sha256)
    if trace is not None:
        _write_trace(recognition, trace / path.stem, path)
    return line


def _notes(model: PointChainModel) -> tuple[str, ...]:
    """Return what people should know: a verdict other than `accept`, the doubts, excluded views, and missing parts."""
    quality = model.quality
    verdict = () if quality.verdict == "accept" else (f"verdict: {quality.verdict}",)
    doubts = (f"{found.severity}: {found.message} [{found.code}]" for found in quality.doubts)
    notes = [found for found in quality.findings if found.severity == "note"]
    views = (found.message for found in notes if found.view is not None)
    missing = (found.message for found in notes if found.code in ("recording-incomplete", "colour-unusable"))
    return (*verdict, *doubts, *views, *missing)


def failed_line(file: str, request: RecognitionRequest, slug: str, reason: str, sha256: str | None) -> RecordingLine:
    """Return the line of a recording without a model. `sha256` is the hash of the recording, as in `hash_recording`."""
    document = {"schema": SCHEMA, "error": error_document(slug, reason, file=file)}
    return _line(file, request, document, sha256, reason)


def hash_recording(path: Path) -> str | None:
    """Return the SHA-256 of a file; None if it does not exist or cannot be read."""
    try:
        if not path.is_file():  # reading a pipe would block
            return None
        return hash_file(path)
    except OSError:
        return None


def _write_trace(recognition: Recognition, folder: Path, recording: Path) -> None:
    """Write the pictures. A failure is only reported, because the model is worth more."""
    try:
        write_trace(recognition, folder, read_truth(recording))
    except (OSError, ValueError, KeyError) as error:
        print(f"pointchain recognise: {recording}: no pictures were written: {error!r}", file=sys.stderr)


def read_truth(recording: Path) -> dict[str, Any] | None:
    """Return the ground truth beside a simulated recording; None if it has none."""
    path = recording.with_suffix(".truth.json")
    return json.loads(path.read_bytes()) if path.is_file() else None


def _line(
    file: str, request: RecognitionRequest, document: dict[str, Any], sha256: str | None, reason: str | None = None
) -> RecordingLine:
    recording = {"file": file, "sha256": sha256}
    text = json.dumps(document | {"recording": recording, "request": request_document(request)}, allow_nan=False)
    return RecordingLine(file, text, reason)
