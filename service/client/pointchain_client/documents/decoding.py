"""Decoder from JSON values to dataclasses, by the type hints of the fields.

The hints may be `bool`, `int`, `float`, `str`, `Any`, another dataclass, `X | None`, `tuple[X, ...]`, `tuple[X, Y]`,
`Mapping[str, X]`, a NumPy array with an `ArrayShape`, and a union of dataclasses that their `KIND` distinguishes.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Decoder = Callable[[Any, str], Any]
"""Function of a JSON value and the name of its member that returns the decoded value."""

_DERIVED, _REST = "derived", "rest"


class DecodeError(ValueError):
    """A JSON value does not have the expected form. The message names the member."""


class ArrayShape:
    """Shape of an array in a type hint, such as (N, 3)."""

    def __init__(self, *lengths: int | None, nulls: bool = False) -> None:
        """Create the shape.

        Args:
            *lengths: Length of each axis. None: any length.
            nulls: Whether numbers may be null. Null becomes NaN.
        """
        self.lengths = lengths
        self.nulls = nulls

    def __repr__(self) -> str:
        lengths = ", ".join("N" if length is None else str(length) for length in self.lengths)
        return f"({lengths})" if len(self.lengths) > 1 else f"({lengths},)"


Points = Annotated[NDArray[np.float64], ArrayShape(None, 3)]
"""(N, 3) array."""
Point = Annotated[NDArray[np.float64], ArrayShape(3)]
"""(3,) array."""
Pose = Annotated[NDArray[np.float64], ArrayShape(4, 4)]
"""(4, 4) array."""
Joints = Annotated[NDArray[np.float64], ArrayShape(6)]
"""(6,) array."""
Heights = Annotated[NDArray[np.float64], ArrayShape(None, None, nulls=True)]
"""(N, M) array of numbers; NaN where the document has null."""
Values = Annotated[NDArray[np.float64], ArrayShape(None)]
"""(N,) array of numbers."""
Counts = Annotated[NDArray[np.int64], ArrayShape(None)]
"""(N,) array of integers."""
Matrix = Annotated[NDArray[np.int64], ArrayShape(None, None)]
"""(N, M) array of integers."""


def derived(**options: Any) -> Any:
    """Return a field that is not a member of the document."""
    return field(**options, metadata={_DERIVED: True})


def rest_of_members() -> Any:
    """Return a field that holds the members of the document that no other field describes."""
    return field(default_factory=dict, metadata={_REST: True})


def member_names(kind: type) -> set[str]:
    """Return the names of the members that a dataclass describes."""
    return {entry.name for entry in fields(kind) if not entry.metadata}


def decode(kind: type[T], value: Any, member: str = "") -> T:
    """Return a JSON value as an object of a dataclass.

    Args:
        kind: The dataclass.
        value: The JSON value.
        member: Name of the member that has the value, for messages. Empty for a whole document.

    Raises:
        DecodeError: A member is missing or has another type. The message names it.
    """
    return _decoder(kind)(value, member)


@cache
def _decoder(hint: Any) -> Decoder:
    """Return the decoder of a type hint."""
    if is_dataclass(hint):
        return _dataclass_decoder(cast(type, hint))
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _array_decoder(np.dtype(get_args(get_args(arguments[0])[1])[0]), arguments[1])
    if origin in (Union, UnionType):
        return _union_decoder(arguments)
    if origin is tuple:
        return _tuple_decoder(arguments)
    if origin is Mapping:
        return _mapping_decoder(_decoder(arguments[1]))
    return _SCALARS[hint]


def _dataclass_decoder(kind: type) -> Decoder:
    hints = get_type_hints(kind, include_extras=True)
    entries: list[tuple[Field[Any], Decoder]] = [
        (entry, _decoder(hints[entry.name])) for entry in fields(kind) if not entry.metadata
    ]
    rest = next((entry.name for entry in fields(kind) if _REST in entry.metadata), None)
    names = member_names(kind)

    def decode_members(value: Any, member: str) -> Any:
        if not isinstance(value, Mapping):
            raise _error(member, "an object", value)
        prefix = f"{member}." if member else ""
        values: dict[str, Any] = {}
        for entry, decode_member in entries:
            if entry.name in value:
                values[entry.name] = decode_member(value[entry.name], prefix + entry.name)
            elif entry.default is MISSING and entry.default_factory is MISSING:
                raise DecodeError(f"the member {prefix}{entry.name} is missing")
        if rest is not None:
            values[rest] = {name: found for name, found in value.items() if name not in names}
        return kind(**values)

    return decode_members


def _array_decoder(dtype: "np.dtype[Any]", shape: ArrayShape) -> Decoder:
    expected = f"an array of {'integers' if dtype.kind == 'i' else 'numbers'} of shape {shape}"
    kinds = "iu" if dtype.kind == "i" else "iuf"

    def decode_array(value: Any, member: str) -> Any:
        try:
            found = np.asarray(value if isinstance(value, list | tuple) else None)
        except ValueError as error:
            raise DecodeError(f"the member {member} must be {expected}: {error}") from error
        is_null = np.zeros(found.shape, dtype=np.bool_)
        if shape.nulls and found.dtype.kind == "O":  # numbers beside nulls
            items = found.ravel().tolist()
            is_null = np.array([item is None for item in items], dtype=np.bool_).reshape(found.shape)
            found = np.array([0 if item is None else item for item in items]).reshape(found.shape)
        if found.size == 0 and shape.lengths[0] is None:
            found = np.zeros([length or 0 for length in shape.lengths], dtype)
        fits = found.ndim == len(shape.lengths) and all(
            length in (None, actual) for length, actual in zip(shape.lengths, found.shape, strict=True)
        )
        if not fits or found.dtype.kind not in kinds or not np.isfinite(found).all():
            raise DecodeError(f"the member {member} must be {expected}")
        return np.where(is_null, np.nan, found).astype(dtype) if is_null.any() else found.astype(dtype)

    return decode_array


def _union_decoder(arguments: tuple[Any, ...]) -> Decoder:
    """Return the decoder of `X | None`, of `int | str`, or of dataclasses of which all but the last have a `KIND`."""
    kinds = [argument for argument in arguments if argument is not NoneType]
    if int in kinds and str in kinds:
        decode_text, decode_integer = _decoder(str), _decoder(int)
        return lambda value, member: (
            None
            if value is None and NoneType in arguments
            else (decode_text if isinstance(value, str) else decode_integer)(value, member)
        )
    by_name = {kind.KIND: _decoder(kind) for kind in kinds[:-1]}
    other = _decoder(kinds[-1])

    def decode_union(value: Any, member: str) -> Any:
        if value is None and NoneType in arguments:
            return None
        name = value.get("kind") if by_name and isinstance(value, Mapping) else None
        return by_name.get(name, other)(value, member) if isinstance(name, str) else other(value, member)

    return decode_union


def _tuple_decoder(arguments: tuple[Any, ...]) -> Decoder:
    if arguments[-1] is Ellipsis:
        decode_item = _decoder(arguments[0])

        def decode_items(value: Any, member: str) -> Any:
            if not isinstance(value, list | tuple):
                raise _error(member, "an array", value)
            return tuple(decode_item(item, f"{member}[{number}]") for number, item in enumerate(value))

        return decode_items
    decoders = [_decoder(argument) for argument in arguments]

    def decode_fixed(value: Any, member: str) -> Any:
        if not isinstance(value, list | tuple) or len(value) != len(decoders):
            raise _error(member, f"an array of {len(decoders)} items", value)
        pairs = zip(decoders, value, strict=True)
        return tuple(decode_item(item, f"{member}[{number}]") for number, (decode_item, item) in enumerate(pairs))

    return decode_fixed


def _mapping_decoder(decode_item: Decoder) -> Decoder:
    def decode_mapping(value: Any, member: str) -> Any:
        if not isinstance(value, Mapping):
            raise _error(member, "an object", value)
        return {name: decode_item(item, f"{member}.{name}") for name, item in value.items()}

    return decode_mapping


def _decode_number(value: Any, member: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise _error(member, "a finite number", value)
    return float(value)


def _scalar_decoder(kind: type, expected: str) -> Decoder:
    def decode_scalar(value: Any, member: str) -> Any:
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise _error(member, expected, value)
        return value

    return decode_scalar


_SCALARS: dict[Any, Decoder] = {
    Any: lambda value, _: value,
    bool: _scalar_decoder(bool, "true or false"),
    int: _scalar_decoder(int, "an integer"),
    float: _decode_number,
    str: _scalar_decoder(str, "a text"),
}


def _error(member: str, expected: str, value: Any) -> DecodeError:
    shown = repr(value)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    return DecodeError(f"{f'the member {member}' if member else 'the document'} must be {expected}, not {shown}")
