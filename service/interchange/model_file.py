"""Reading of a model: from the output of `pointchain recognise`, or from the recording of a live scan."""

import json
import math
import sys
from pathlib import Path
from typing import Any, NoReturn

from mcap.writer import MCAP0_MAGIC
from pydantic import ValidationError

from calibration.atomic_write import TooLargeError, read_limited
from cell.recording import read_result
from recognition.errors import ModelError
from recognition.model.document import ModelDocument
from recognition.model.model import SCHEMA, check_schema
from service.interchange.errors import ExportError

STDIN = Path("-")
MAX_BYTES = 64 << 20
"""Limit on the size of a model. A model has about ten kilobytes per metre of string."""


def read_model(path: Path) -> dict[str, Any]:
    """Read and check a model document.

    Args:
        path: JSON file or recording; `-` is stdin.

    Raises:
        ExportError: The file holds no model, several models, or an error in place of a model.
        RecordingError: The recording cannot be read.
    """
    if path != STDIN and _is_mcap(path):
        document = read_result(path)
        if document is None:
            raise ExportError(
                f"{path.name} holds no model, because only the recording of a live scan holds one: run `pointchain "
                f"recognise {path.name}` and export its output"
            )
    else:
        document = _parse(_read(path), "stdin" if path == STDIN else path.name)
    return _check(document, "stdin" if path == STDIN else path.name)


def _is_mcap(path: Path) -> bool:
    try:
        if not path.is_file():  # reading a pipe would block
            return False
        with path.open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError as error:
        raise ExportError(f"{path} cannot be read: {error.strerror or error}") from error


def _read(path: Path) -> bytes:
    if path == STDIN:
        content = sys.stdin.buffer.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise ExportError(f"stdin has more than {MAX_BYTES >> 20} MiB, more than any model: give one model")
        return content
    try:
        return read_limited(path, MAX_BYTES)
    except (FileNotFoundError, IsADirectoryError, TooLargeError) as error:
        raise ExportError(str(error)) from error
    except OSError as error:
        raise ExportError(f"{path} cannot be read: {error.strerror or error}") from error


def _parse(content: bytes, name: str) -> Any:
    try:
        return json.loads(content, parse_constant=_reject_constant, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        lines = [line for line in content.splitlines() if line.strip()]
        if len(lines) > 1 and all(line.startswith(b"{") for line in lines):
            raise ExportError(
                f"{name} has {len(lines)} documents: give one, for example by `sed -n 1p {name} | pointchain export - "
                "OUT`"
            ) from error
        raise ExportError(f"{name} is not a model, because it is not JSON: {error}") from error


def _check(document: Any, name: str) -> dict[str, Any]:
    try:
        check_schema(document)
    except ModelError as error:
        raise ExportError(f"{name} is not a model that can be exported: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ExportError(f"{name} is not a model: a JSON object with schema {SCHEMA!r} is needed")
    if "error" in document:
        error = document["error"]
        detail = error.get("detail") if isinstance(error, dict) else error
        raise ExportError(f"{name} holds an error, not a model: {detail}")
    try:
        model = ModelDocument.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ExportError(f"{name} is not a model: {where}: {first['msg']}") from error
    for chain in model.chains:
        if not len(chain.points) == len(chain.arc_length_m) == len(chain.sigma_m) == len(chain.views):
            raise ExportError(f"{name} is not a model: chain {chain.id} has a different number of values and points")
    ids = {chain.id for chain in model.chains}
    if len(ids) < len(model.chains) or any({c.over.chain, c.under.chain} - ids for c in model.crossings):
        raise ExportError(f"{name} is not a model: two chains have the same id, or a crossing has an unknown chain")
    return document


def _reject_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}")


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        _reject_constant(number)
    return value
