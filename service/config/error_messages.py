"""Messages about errors in a configuration. They name each key as the file does, and what the key accepts."""

import difflib
import math
import types
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from cell.config.strict_model import unit_hint

MAX_VALUE_LENGTH = 60
"""Maximum number of characters of a value in a message. A longer value is truncated."""
_BOUND_PHRASES = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most"}


def describe_errors(error: ValidationError, settings: type[BaseModel], variables: Mapping[str, str]) -> list[str]:
    """Return one line per error, in the order of the settings.

    Args:
        error: Error of the validation.
        settings: The class that was validated.
        variables: Names of the environment variables that are set, by the key that they set: the parts in capitals,
            joined by two underscores, as `ARM__HOST`.
    """
    lines = [_describe_error(item, settings, variables) for item in error.errors(include_url=False)]
    return list(dict.fromkeys(lines))  # a list that is too short has an error, with the same line, per missing element


def suggest_name(name: str, known: list[str], prefix: str = "") -> str:
    """Return a hint: the known name that is similar to `name`, or all known names.

    Args:
        name: The unknown name.
        known: All known names.
        prefix: Text before each name in the hint.
    """
    similar = difflib.get_close_matches(name.lower(), [other.lower() for other in known], 1, 0.6)
    if similar:
        return f"did you mean {prefix}{next(other for other in known if other.lower() == similar[0])}?"
    return f"known names: {', '.join(prefix + other for other in known)}"


@dataclass
class _Location:
    """Location of an error in the settings."""

    keys: list[str] = field(default_factory=list)
    """Keys from the outermost section to the setting."""
    name: str = ""
    """Name of the setting, as `arm.host` or `workspace.x_m[1]`."""
    annotation: Any = None
    """Type of the setting, or None if it is unknown."""
    bounds: list[Any] = field(default_factory=list)
    """Limits of the setting, as annotated-types objects."""
    parent: type[BaseModel] | None = None
    """Section that contains the setting."""
    kind: str | None = None
    """Kind of arm or camera that this section describes."""


def _describe_error(item: ErrorDetails, settings: type[BaseModel], variables: Mapping[str, str]) -> str:
    # a list that is too short is reported as a whole
    too_short = item["type"] == "missing" and isinstance(item["loc"][-1], int)
    location = _locate(settings, item["loc"][:-1] if too_short else item["loc"])
    variable = _variable_of(location.keys, variables)
    name = f"{location.name} (set by {variable})" if variable else location.name
    value = item["input"]
    if item["type"] == "extra_forbidden":
        what = "section" if isinstance(value, dict) else "setting"
        return f"{name}: unknown {what}; {_suggest_location(location, settings)}"
    if too_short:
        return f"{name} is {_format_value(value)}; it must be {_expected_value(location)}"
    if item["type"] == "missing":
        if location.kind:
            return f'{name} is missing; kind = "{location.kind}" requires it'
        return f"{name} is missing; {_expected_value(location)} is required"
    if _section_classes(location.annotation) and not isinstance(value, dict | BaseModel):
        return f"{name} is {_format_value(value)}; it is a section: write [{location.name}] and its settings below it"
    if item["type"] == "kind" and isinstance(value, dict):
        kinds = _join_choices(list(_sections_by_kind(location.annotation)))
        return f"{location.name}.kind is {_format_value(value.get('kind'))}; it must be {kinds}"
    if item["type"] == "value_error":
        message = str(item.get("ctx", {}).get("error", item["msg"]))
        if not location.name:
            return message
        if isinstance(value, dict | BaseModel):
            return f"{name}: {message}"
        return f"{name} is {_format_value(value)}; {message}"
    hints = _choice_hint(location, value) + _unit_hint(location, value)
    return f"{name} is {_format_value(value)}; it must be {_expected_value(location)}{hints}"


def _locate(settings: type[BaseModel], loc: tuple[int | str, ...]) -> _Location:
    """Follow pydantic's location of an error through the settings classes."""
    location, model = _Location(), settings
    for part in loc:
        kinds = _sections_by_kind(location.annotation)
        if isinstance(part, int):
            arguments = get_args(_without_none(location.annotation))
            is_variadic = arguments[-1:] == (...,)
            location.annotation = arguments[0] if is_variadic else arguments[min(part, len(arguments) - 1)]
            location.name += f"[{part}]"
            location.bounds = []
        elif part in kinds:
            model, location.kind = kinds[part], part
        else:
            found = model.model_fields.get(part)
            location.parent = model
            location.name = f"{location.name}.{part}" if location.name else part
            location.keys.append(part)
            location.annotation, location.bounds = (found.annotation, found.metadata) if found else (None, [])
            inner = _section_classes(location.annotation)
            model = inner[0] if len(inner) == 1 else BaseModel
    return location


def _suggest_location(location: _Location, settings: type[BaseModel]) -> str:
    """Return a hint at where an unknown key may belong."""
    key, parent = location.keys[-1], location.parent or settings
    siblings = list(parent.model_fields)
    if difflib.get_close_matches(key.lower(), siblings, 1, 0.75):
        return suggest_name(key, siblings)
    for section, section_field in settings.model_fields.items():
        for kind, model in _sections_by_kind(section_field.annotation).items():
            if key in model.model_fields and location.keys[0] == section:
                return f'only kind = "{kind}" has it'
        if any(key in model.model_fields for model in _section_classes(section_field.annotation)):
            return f"move it to the section [{section}]"
    if parent is not settings and key in settings.model_fields:
        return "move it above the first [section]"
    return suggest_name(key, siblings)


def _variable_of(keys: list[str], variables: Mapping[str, str]) -> str | None:
    """Return the variable that set the key or a section that contains it."""
    names = ["__".join(keys[:end]).upper() for end in range(len(keys), 0, -1)]
    return next((variables[name] for name in names if name in variables), None)


def _expected_value(location: _Location) -> str:
    """Return what the setting accepts, as "a number greater than 0 and at most 3.2"."""
    plain = _without_none(location.annotation)
    choices = [str(choice) for choice in get_args(plain)] if get_origin(plain) is Literal else []
    expected = _join_choices(choices) if choices else _describe_type(plain, plural=False)
    bounds = _bounds_by_name(location)
    if "ge" in bounds and "le" in bounds:
        return f"{expected} from {_format_number(bounds['ge'])} to {_format_number(bounds['le'])}"
    limits = [f"{text} {_format_number(bounds[name])}" for name, text in _BOUND_PHRASES.items() if name in bounds]
    limits += ["that is not empty"] if "min_length" in bounds else []
    return " ".join([expected, " and ".join(limits)]).strip()


def _bounds_by_name(location: _Location) -> dict[str, Any]:
    """Return the limits of the setting by name, as `ge` or `min_length`."""
    # annotated-types' Ge, Lt and so on each have one attribute, with the lower-case name of the class
    names = (*_BOUND_PHRASES, "min_length")
    return {name: getattr(bound, name) for bound in location.bounds for name in names if hasattr(bound, name)}


def _describe_type(annotation: Any, *, plural: bool) -> str:
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple:
        element = _describe_type(arguments[0], plural=True)
        count = "" if arguments[-1] is ... else f"{len(arguments)} "
        return f"{'lists' if plural else 'a list'} of {count}{element}"
    singular_name, plural_name = {
        bool: ("true or false", "true or false"),
        int: ("a whole number", "whole numbers"),
        float: ("a number", "numbers"),
        str: ("text", "texts"),
        Path: ("a path", "paths"),
    }.get(annotation, ("another value", "other values"))
    return plural_name if plural else singular_name


def _choice_hint(location: _Location, value: object) -> str:
    """Return a hint if the value is similar to an accepted one."""
    choices = [str(choice) for choice in get_args(_without_none(location.annotation)) if isinstance(choice, str)]
    similar = difflib.get_close_matches(str(value).lower(), choices, 1, 0.6)
    return f'; did you mean "{similar[0]}"?' if similar else ""


def _unit_hint(location: _Location, value: object) -> str:
    """Return a hint if a number looks like millimetres or degrees."""
    bounds = _bounds_by_name(location)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return ""
    try:
        number = float(value)  # an environment variable is text
    except ValueError:
        return ""
    low, high = bounds.get("ge", bounds.get("gt", -math.inf)), bounds.get("le", bounds.get("lt", math.inf))
    return unit_hint(location.keys[-1], number, low, high)


def _join_choices(names: list[str]) -> str:
    quoted = [f'"{name}"' for name in names]
    return " or ".join([", ".join(quoted[:-1]), quoted[-1]]) if quoted[1:] else quoted[0]


def _format_number(value: Any) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _format_value(value: object) -> str:
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= MAX_VALUE_LENGTH else text[: MAX_VALUE_LENGTH - 3] + "..."


def _without_none(annotation: Any) -> Any:
    """Return `X` for `X | None`."""
    if get_origin(annotation) in (Union, types.UnionType):
        rest = [argument for argument in get_args(annotation) if argument is not types.NoneType]
        return rest[0] if len(rest) == 1 else annotation
    return annotation


def _section_classes(annotation: Any) -> list[type[BaseModel]]:
    """Return the settings classes that a field may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is Annotated:
        return _section_classes(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [model for argument in get_args(annotation) for model in _section_classes(argument)]
    return []


def _sections_by_kind(annotation: Any) -> dict[str, type[BaseModel]]:
    """Return the settings classes that a field may hold, by their `kind`."""
    models = _section_classes(annotation)
    return {str(get_args(m.model_fields["kind"].annotation)[0]): m for m in models if "kind" in m.model_fields}
