"""The model in a file: what `recognise` prints, or what a live scan's recording keeps."""

import json
import math
import sys
from pathlib import Path
from typing import Any, NoReturn

from mcap.writer import MCAP0_MAGIC
from pydantic import ValidationError

from calibration.atomic_write import TooLargeError, read_limited
from cell.recording.writer import read_result
from recognition.model.document import ModelDocument
from recognition.model.model import SCHEMA
from service.interchange.errors import ExportError

STDIN = Path("-")
MOST_BYTES = 64 << 20
"""A model has some ten kilobytes a metre of string."""


def read_model(path: Path) -> dict[str, Any]:
    """The model document in `path`, checked; `-` is stdin.

    Raises:
        ExportError: there is none, more than one, or why there is none is all that the file tells.
        RecordingError: a recording that cannot be read.
    """
    if path != STDIN and _is_mcap(path):
        document = read_result(path)
        if document is None:
            raise ExportError(
                f"{path.name} holds no model, only a live scan's recording does: pointchain recognise {path.name} "
                "gives it"
            )
    else:
        document = _parsed(_content(path), "stdin" if path == STDIN else path.name)
    return _checked(document, "stdin" if path == STDIN else path.name)


def _is_mcap(path: Path) -> bool:
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError as error:
        raise ExportError(f"{path} cannot be read: {error.strerror or error}") from error


def _content(path: Path) -> bytes:
    if path == STDIN:
        content = sys.stdin.buffer.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ExportError(f"stdin has more than {MOST_BYTES >> 20} MiB: no model is so large")
        return content
    try:
        return read_limited(path, MOST_BYTES)
    except (FileNotFoundError, IsADirectoryError, TooLargeError) as error:
        raise ExportError(str(error)) from error
    except OSError as error:
        raise ExportError(f"{path} cannot be read: {error.strerror or error}") from error


def _parsed(content: bytes, name: str) -> Any:
    try:
        return json.loads(content, parse_constant=_refuse_constant, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        lines = [line for line in content.splitlines() if line.strip()]
        if len(lines) > 1 and all(line.startswith(b"{") for line in lines):
            raise ExportError(
                f"{name} has {len(lines)} documents: give one, as by `sed -n 1p {name} | pointchain export - OUT`"
            ) from error
        raise ExportError(f"{name} is no model, for it is not JSON: {error}") from error


def _checked(document: Any, name: str) -> dict[str, Any]:
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ExportError(f"{name} is no model: a JSON object with schema {SCHEMA!r} is needed")
    if "error" in document:
        error = document["error"]
        detail = error.get("detail") if isinstance(error, dict) else error
        raise ExportError(f"{name} tells why there is no model: {detail}")
    try:
        model = ModelDocument.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ExportError(f"{name} is no model: {where}: {first['msg']}") from error
    for chain in model.chains:
        if not len(chain.points) == len(chain.arc_length_m) == len(chain.sigma_m) == len(chain.views):
            raise ExportError(f"{name} is no model: chain {chain.id} has not as many values as points")
    ids = {chain.id for chain in model.chains}
    if len(ids) < len(model.chains) or any({c.over.chain, c.under.chain} - ids for c in model.crossings):
        raise ExportError(f"{name} is no model: ids of chains are there twice, or a crossing is of none of them")
    return document


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}")


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        _refuse_constant(number)
    return value
