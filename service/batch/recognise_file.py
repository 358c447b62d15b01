"""One recording to one line: its model, or why there is none, with what it is of and how it was asked for."""

import hashlib
import json
import math
import sys
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from recognition.grasping.gripper import Gripper
from recognition.model.model import SCHEMA, Method, PointChainModel
from recognition.pipeline import Recognition
from service.errors import INPUT_ERRORS
from service.problems.document import error_document
from service.processing.results import OnStage, recognise_recording
from service.processing.stage_figures import write_trace


@dataclass(frozen=True)
class Asked:
    """How recordings are to be recognised: what a line must agree in to stand for another one of its recording."""

    method: Method = "graph"
    radius_m: float | None = None
    """Of the strings; None for the recording's own, else it is measured."""
    gripper: Gripper = field(default_factory=Gripper)
    """That grasps are for."""
    version: str = field(default_factory=lambda: version("pointchain"))
    settings: Mapping[str, float] = field(default_factory=dict)
    """Parameter values by name, in place of those for the radius."""

    def to_json(self) -> dict[str, Any]:
        """Return the member `asked` of a line. A radius that is NaN or infinite, which is refused, becomes text.

        `settings` is left out when nothing was set.
        """
        told = self.radius_m is None or math.isfinite(self.radius_m)
        document = asdict(self) | {"radius_m": self.radius_m if told else str(self.radius_m)}
        if not self.settings:
            del document["settings"]
        return document


@dataclass(frozen=True)
class Line:
    """What came of one recording."""

    file: str
    """As it was asked for."""
    text: str
    """One JSON document, without a line break: the model, or `{"schema", "error"}`, and `recording` and `asked`."""
    reason: str | None = None
    """Why there is no model."""
    notes: tuple[str, ...] = ()
    """Messages about views that the model does not use."""


def recognise_file(
    file: str, asked: Asked, trace: Path | None = None, on_stage: OnStage | None = None, path: Path | None = None
) -> Line:
    """Recognises a recording. `path` is where it is, when `file` is only what to call it.

    Raises nothing: whatever is wrong with one file must not take the others' results.
    """
    path = Path(file) if path is None else path
    try:
        recognition = recognise_recording(path, asked.radius_m, asked.method, on_stage, asked.gripper, asked.settings)
        line = replace(_line(file, asked, recognition.model.to_json(), path), notes=_notes(recognition.model))
    except INPUT_ERRORS as error:
        return failed(file, asked, error.slug, str(error), path)
    except OSError as error:
        return failed(file, asked, "file", f"{error.filename or file}: {error.strerror or error}", path)
    except BaseException as error:  # a panic of native code is no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            raise
        # A fault of ours is told, with all that helps to mend it.
        traceback.print_exc(file=sys.stderr)
        return failed(file, asked, "internal", f"unexpected error, please report it: {error!r}", path)
    if trace is not None:
        _write_trace(recognition, trace / path.stem, path)
    return line


def _notes(model: PointChainModel) -> tuple[str, ...]:
    """Return a message for each view that recognition excluded: nothing else on the command line shows it."""
    return tuple(f"view {view.index} was not used: {view.reason}" for view in model.quality.views if not view.used)


def failed(file: str, asked: Asked, slug: str, reason: str, path: Path) -> Line:
    """The line of a recording without a model."""
    document = {"schema": SCHEMA, "error": error_document(slug, reason, file=file)}
    return _line(file, asked, document, path, reason)


def sha256_of(path: Path) -> str | None:
    """Of a file's content; None when there is no such file, or it cannot be read."""
    try:
        if not path.is_file():  # a pipe would be waited for
            return None
        with path.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError:
        return None


def _write_trace(recognition: Recognition, folder: Path, recording: Path) -> None:
    """The pictures, or why there are none: the model is worth more."""
    try:
        write_trace(recognition, folder, truth_beside(recording))
    except (OSError, ValueError, KeyError) as error:
        print(f"pointchain recognise: {recording}: no pictures: {error!r}", file=sys.stderr)


def truth_beside(recording: Path) -> dict[str, Any] | None:
    """The truth file of a simulated recording, None where there is none."""
    path = recording.with_suffix(".truth.json")
    return json.loads(path.read_bytes()) if path.is_file() else None


def _line(file: str, asked: Asked, document: dict[str, Any], path: Path, reason: str | None = None) -> Line:
    of = {"file": file, "sha256": sha256_of(path)}
    return Line(file, json.dumps(document | {"recording": of, "asked": asked.to_json()}, allow_nan=False), reason)
