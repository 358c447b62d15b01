"""What the JSON files of a calibration are made of, and what is wrong with one, told with its file and field."""

import json
import reprlib
from datetime import datetime
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, TypeAdapter, ValidationError

from calibration.errors import HandEyeError
from calibration.geometry.transforms import from_quaternion, rigid, to_quaternion
from calibration.target.board import Board

STRICT = ConfigDict(strict=True, allow_inf_nan=False, str_min_length=1)


class Form(BaseModel):
    """A JSON object. Text and true or false are no numbers, NaN and infinity neither; text is not empty."""

    model_config = STRICT


Numbers3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Numbers4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Numbers6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Matrix3 = Annotated[list[Numbers3], Field(min_length=3, max_length=3)]
Matrix4 = Annotated[list[Numbers4], Field(min_length=4, max_length=4)]


def _pinhole(K: list[list[float]]) -> list[list[float]]:
    if not (K[2] == [0, 0, 1] and K[0][0] > 0 and K[1][1] > 0 and K[0][1] == K[1][0] == 0):
        raise ValueError(
            "a pinhole matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels is needed; one with skew is not taken"
        )
    return K


PinholeMatrix = Annotated[Matrix3, AfterValidator(_pinhole)]
_MATRIX4 = TypeAdapter(Matrix4, config=STRICT)


class _QuaternionPose(Form):
    xyz_m: Numbers3
    quat_xyzw: Numbers4


def to_transform(value: object) -> NDArray[np.float64]:
    """(4, 4) the rigid transform that a file gives as such a matrix or as `{"xyz_m": [3], "quat_xyzw": [4]}`.

    Raises:
        ValueError: it is neither; pydantic's ValidationError and NotRigidError are such.
    """
    if isinstance(value, dict):
        pose = _QuaternionPose.model_validate(value)
        return from_quaternion(pose.xyz_m, pose.quat_xyzw, "the transform")
    if not isinstance(value, list):
        raise ValueError('a 4x4 matrix or {"xyz_m": [3], "quat_xyzw": [4]} is needed')
    return rigid(_MATRIX4.validate_python(value), "the transform")


Transform = Annotated[NDArray[np.float64], PlainValidator(to_transform)]
BoardObject = Annotated[Board, PlainValidator(Board.from_json)]


def _to_time(value: Any) -> datetime:
    try:
        time = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        raise ValueError(f'{str(value)[:40]!r} is no time; one as "2026-01-31T12:00:00+00:00" is needed') from None
    if time.tzinfo is None:
        raise ValueError(f"{value!r} lacks the time zone, as +00:00")
    return time


Time = Annotated[datetime, PlainValidator(_to_time)]
"""ISO 8601 with a time zone."""

_NEEDED = {
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than_equal": "a number from {ge:g} on",
    "int_type": "a whole number",
    "less_than_equal": "a number up to {le:g}",
    "list_type": "a list, [...],",
    "literal_error": "{expected}",
    "model_type": "an object, {{...}},",
    "string_too_short": "text that is not empty",
    "string_type": "text",
    "too_long": "a list of at most {max_length}",
    "too_short": "a list of at least {min_length}",
}
"""By pydantic's name of the fault."""

AnyForm = TypeVar("AnyForm", bound=Form)


def read_form(form: type[AnyForm], content: bytes, where: object, error: type[HandEyeError]) -> AnyForm:
    """The content of the JSON file `where`. Raises `error` when it is not of this form."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as wrong:
        why = str(wrong).replace(": ", ", ")  # what comes after a colon is what to do
        raise error(f"{where} is not JSON ({why}): write it anew, or take the former one") from wrong
    if not isinstance(document, dict):
        raise error(f"{where} holds something else: it is not a JSON object")
    try:
        return form.model_validate(document)
    except ValidationError as wrong:
        raise error(f"{where}: {_first_fault(wrong)}") from wrong


def _first_fault(error: ValidationError, within: tuple[int | str, ...] = ()) -> str:
    """The first thing that is wrong, as "camera.width is 0; a number from 1 on is needed"."""
    fault: Any = error.errors(include_url=False)[0]
    place, kind, context = within + fault["loc"], fault["type"], fault.get("ctx", {})
    if isinstance(context.get("error"), ValidationError):
        return _first_fault(context["error"], place)
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
    if kind == "missing":
        return f"{name} is missing: add it"
    if kind == "extra_forbidden":
        return f"{name} is not known here: check how it is written, or leave it out"
    if kind == "value_error":
        return f"{name}: {context['error']}"
    words = f"{_NEEDED[kind].format(**context)} is needed" if kind in _NEEDED else fault["msg"]
    return f"{name} is {reprlib.repr(fault['input'])}; {words}"


def time_document(time: datetime | None) -> str | None:
    """A time as JSON, to the second."""
    return None if time is None else time.isoformat(timespec="seconds")


def transform_document(T: NDArray[np.float64]) -> dict[str, list[float]]:
    """A rigid transform (4, 4) as JSON."""
    return {"xyz_m": T[:3, 3].tolist(), "quat_xyzw": to_quaternion(T).tolist()}
