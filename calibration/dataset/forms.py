"""Schemas of the JSON values in calibration files, and error messages with the file name and the field name."""

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

STRICT_CONFIG = ConfigDict(strict=True, allow_inf_nan=False, str_min_length=1)
"""Strict pydantic settings: no conversion of strings and booleans to numbers, no NaN, no infinity, no empty strings."""


class Form(BaseModel):
    """Base class of the schemas of JSON objects. The settings are `STRICT_CONFIG`."""

    model_config = STRICT_CONFIG


Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Vector4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Vector6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]
Matrix4 = Annotated[list[Vector4], Field(min_length=4, max_length=4)]


def _check_pinhole(K: list[list[float]]) -> list[list[float]]:
    if not (K[2] == [0, 0, 1] and K[0][0] > 0 and K[1][1] > 0 and K[0][1] == K[1][0] == 0):
        raise ValueError(
            "a pinhole matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels is needed; skew is not supported"
        )
    return K


PinholeMatrix = Annotated[Matrix3, AfterValidator(_check_pinhole)]
_MATRIX4 = TypeAdapter(Matrix4, config=STRICT_CONFIG)


class _QuaternionPose(Form):
    xyz_m: Vector3
    quat_xyzw: Vector4


def transform_from_json(value: object) -> NDArray[np.float64]:
    """Convert a JSON value to a rigid transform.

    Args:
        value: A 4x4 matrix, or `{"xyz_m": [3], "quat_xyzw": [4]}`.

    Returns:
        (4, 4) rigid transform, metres.

    Raises:
        ValueError: The value has another form. The error may be a pydantic.ValidationError, which is a subclass.
        NotRigidError: The matrix is not a rigid transform, or the length of the quaternion is not 1.
    """
    if isinstance(value, dict):
        pose = _QuaternionPose.model_validate(value)
        return from_quaternion(pose.xyz_m, pose.quat_xyzw, "the transform")
    if not isinstance(value, list):
        raise ValueError('a 4x4 matrix or {"xyz_m": [3], "quat_xyzw": [4]} is needed')
    return rigid(_MATRIX4.validate_python(value), "the transform")


Transform = Annotated[NDArray[np.float64], PlainValidator(transform_from_json)]
BoardField = Annotated[Board, PlainValidator(Board.from_json)]


def _parse_time(value: Any) -> datetime:
    try:
        time = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        raise ValueError(f'{str(value)[:40]!r} is not a time; write it as "2026-01-31T12:00:00+00:00"') from None
    if time.tzinfo is None:
        raise ValueError(f"{value!r} has no time zone; add one, for example +00:00")
    return time


Timestamp = Annotated[datetime, PlainValidator(_parse_time)]
"""ISO 8601 time with a time zone."""

_EXPECTED = {
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than_equal": "a number of at least {ge:g}",
    "int_type": "a whole number",
    "less_than_equal": "a number of at most {le:g}",
    "list_type": "a list, [...],",
    "literal_error": "{expected}",
    "model_type": "an object, {{...}},",
    "string_too_short": "text that is not empty",
    "string_type": "text",
    "too_long": "a list of at most {max_length}",
    "too_short": "a list of at least {min_length}",
}
"""Description of the expected value in a message, by pydantic error type."""

FormT = TypeVar("FormT", bound=Form)


def parse_form(form: type[FormT], content: bytes, source: object, error: type[HandEyeError]) -> FormT:
    """Parse the content of a JSON file and validate it against a schema.

    Args:
        form: The schema.
        content: Content of the file.
        source: Name of the file in the error message.
        error: Class of the exception to raise.

    Returns:
        The validated JSON object, an instance of `form`.

    Raises:
        HandEyeError: The content is not JSON, or does not match the schema. The exception has the class `error`.
    """
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as invalid:
        reason = str(invalid).replace(": ", ", ")  # A colon in a message separates the error from the advice.
        raise error(f"{source} is not JSON ({reason}): write it again, or use the previous file") from invalid
    if not isinstance(document, dict):
        raise error(f"{source} is not a JSON object: write an object, {{...}}")
    try:
        return form.model_validate(document)
    except ValidationError as invalid:
        raise error(f"{source}: {_describe_first_error(invalid)}") from invalid


def _describe_first_error(error: ValidationError, parents: tuple[int | str, ...] = ()) -> str:
    """Return the message for the first error, for example "camera.width is 0; a number of at least 1 is needed".

    Args:
        error: The validation error.
        parents: Path of field names and list indices from the JSON object to the value with the error.
    """
    first: Any = error.errors(include_url=False)[0]
    location = parents + first["loc"]
    kind = first["type"]
    context = first.get("ctx", {})
    if isinstance(context.get("error"), ValidationError):
        return _describe_first_error(context["error"], location)
    name = "".join(_format_part(part) for part in location).removeprefix(".")
    if kind == "missing":
        return f"{name} is missing: add it"
    if kind == "extra_forbidden":
        return f"{name} is unknown: check the spelling, or remove it"
    if kind == "value_error":
        return f"{name}: {context['error']}"
    problem = f"{name} is {reprlib.repr(first['input'])}"
    if kind not in _EXPECTED:
        return f"{problem}; {first['msg']}"
    return f"{problem}; {_EXPECTED[kind].format(**context)} is needed"


def _format_part(part: int | str) -> str:
    """Return a list index as `[1]`, and a field name as `.name`."""
    return f"[{part}]" if isinstance(part, int) else f".{part}"


def document_to_bytes(document: object) -> bytes:
    """Serialise a JSON document to the content of a file."""
    return (json.dumps(document, indent=2, allow_nan=False) + "\n").encode()


def time_to_json(time: datetime | None) -> str | None:
    """Convert a time to ISO 8601 text with whole seconds. None stays None."""
    if time is None:
        return None
    return time.isoformat(timespec="seconds")


def transform_to_json(T: NDArray[np.float64]) -> dict[str, list[float]]:
    """Convert a rigid transform (4, 4), metres, to a JSON object with `xyz_m` and `quat_xyzw`."""
    return {"xyz_m": T[:3, 3].tolist(), "quat_xyzw": to_quaternion(T).tolist()}
