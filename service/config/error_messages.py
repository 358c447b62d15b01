"""What is wrong with a configuration, in the words of its file: each key by its name, and what it takes."""

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

SHOWN = 60
"""A longer value is cut off in a message."""
_BOUNDS = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}


def explain(error: ValidationError, settings: type[BaseModel], variables: Mapping[str, str]) -> list[str]:
    """One line for each thing that is wrong, in the order of the settings.

    `settings` is the class that was to be made; `variables` says which variable has set a key, by the key's name in
    capitals with two underscores between its parts: `ARM__HOST`.
    """
    lines = [_line(item, settings, variables) for item in error.errors(include_url=False)]
    return list(dict.fromkeys(lines))  # a list that is too short is told for each element that it lacks


def meant(name: str, known: list[str], before: str = "") -> str:
    """A hint at which of the `known` names may have been meant, or at all of them; each with `before` before it."""
    near = difflib.get_close_matches(name.lower(), [other.lower() for other in known], 1, 0.6)
    if near:
        return f"did you mean {before}{next(other for other in known if other.lower() == near[0])}?"
    return f"known are {', '.join(before + other for other in known)}"


@dataclass
class _Place:
    """Where in the settings an error lies."""

    keys: list[str] = field(default_factory=list)
    """From the outermost section to the setting."""
    name: str = ""
    """As `arm.host` or `workspace.x_m[1]`."""
    annotation: Any = None
    """The type of what lies there; None where there is no such setting."""
    bounds: list[Any] = field(default_factory=list)
    parent: type[BaseModel] | None = None
    """The section that the setting is in."""
    kind: str | None = None
    """Which kind of arm or camera that section describes."""


def _line(item: ErrorDetails, settings: type[BaseModel], variables: Mapping[str, str]) -> str:
    # A list that is too short is told as a whole.
    short = item["type"] == "missing" and isinstance(item["loc"][-1], int)
    place = _place(settings, item["loc"][:-1] if short else item["loc"])
    variable = _variable(place.keys, variables)
    name = f"{place.name} (set by {variable})" if variable else place.name
    value = item["input"]
    if item["type"] == "extra_forbidden":
        what = "section" if isinstance(value, dict) else "setting"
        return f"{name}: there is no such {what}; {_belongs(place, settings)}"
    if short:
        return f"{name} is {_shown(value)}; {_taken(place)} is taken"
    if item["type"] == "missing":
        needs = f': kind = "{place.kind}" needs it' if place.kind else f"; {_taken(place)} is needed"
        return f"{name} is missing{needs}"
    if _models(place.annotation) and not isinstance(value, dict | BaseModel):
        return f"{name} is {_shown(value)}; it is a section: a line [{place.name}], and its settings below it"
    if item["type"] == "kind" and isinstance(value, dict):
        kinds = _kinds(place.annotation)
        return f"{place.name}.kind is {_shown(value.get('kind'))}; {_one_of(list(kinds))} is taken"
    if item["type"] == "value_error":
        words = str(item.get("ctx", {}).get("error", item["msg"]))
        if not place.name:
            return words
        return f"{name}: {words}" if isinstance(value, dict | BaseModel) else f"{name} is {_shown(value)}; {words}"
    return f"{name} is {_shown(value)}; {_taken(place)} is taken{_near_choice(place, value)}{_other_unit(place, value)}"


def _place(settings: type[BaseModel], loc: tuple[int | str, ...]) -> _Place:
    place, model = _Place(), settings
    for part in loc:
        kinds = _kinds(place.annotation)
        if isinstance(part, int):
            arguments = get_args(_without_none(place.annotation))
            place.annotation = arguments[0] if arguments[-1:] == (...,) else arguments[min(part, len(arguments) - 1)]
            place.name += f"[{part}]"
            place.bounds = []
        elif part in kinds:
            model, place.kind = kinds[part], part
        else:
            found = model.model_fields.get(part)
            place.parent = model
            place.name = f"{place.name}.{part}" if place.name else part
            place.keys.append(part)
            place.annotation, place.bounds = (found.annotation, found.metadata) if found else (None, [])
            inner = _models(place.annotation)
            model = inner[0] if len(inner) == 1 else BaseModel
    return place


def _belongs(place: _Place, settings: type[BaseModel]) -> str:
    """Where an unknown key may belong."""
    key, parent = place.keys[-1], place.parent or settings
    siblings = list(parent.model_fields)
    if difflib.get_close_matches(key.lower(), siblings, 1, 0.75):
        return meant(key, siblings)
    for section, about in settings.model_fields.items():
        kinds = _kinds(about.annotation)
        for kind, model in kinds.items():
            if key in model.model_fields and place.keys[0] == section:
                return f'only kind = "{kind}" has it'
        if any(key in model.model_fields for model in _models(about.annotation)):
            return f"it is a setting of [{section}]"
    if parent is not settings and key in settings.model_fields:
        return "it stands above the first [section]"
    return meant(key, siblings)


def _variable(keys: list[str], variables: Mapping[str, str]) -> str | None:
    """The variable that set the key, or the section that it is in."""
    names = ["__".join(keys[:end]).upper() for end in range(len(keys), 0, -1)]
    return next((variables[name] for name in names if name in variables), None)


def _taken(place: _Place) -> str:
    """What the setting takes, as "a number more than 0, at most 3.2"."""
    plain = _without_none(place.annotation)
    choices = [str(choice) for choice in get_args(plain)] if get_origin(plain) is Literal else []
    words = _one_of(choices) if choices else _kind_of_value(plain, many=False)
    bound = _bounds(place)
    if "ge" in bound and "le" in bound:
        return f"{words} from {_number(bound['ge'])} to {_number(bound['le'])}"
    limits = [f"{told} {_number(bound[name])}" for name, told in _BOUNDS.items() if name in bound]
    limits += ["not empty"] if "min_length" in bound else []
    return " ".join([words, ", ".join(limits)]).strip()


def _bounds(place: _Place) -> dict[str, Any]:
    """Return the limits of the setting by name, as `ge` or `min_length`."""
    # These are annotated-types' Ge, Lt and so on, each with an attribute of its own name.
    return {name: getattr(b, name) for b in place.bounds for name in (*_BOUNDS, "min_length") if hasattr(b, name)}


def _kind_of_value(annotation: Any, *, many: bool) -> str:
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple:
        each = _kind_of_value(arguments[0], many=True)
        count = "" if arguments[-1] is ... else f"{len(arguments)} "
        return f"{'lists' if many else 'a list'} of {count}{each}"
    one, several = {
        bool: ("true or false", "true or false"),
        int: ("a whole number", "whole numbers"),
        float: ("a number", "numbers"),
        str: ("text", "texts"),
        Path: ("a path", "paths"),
    }.get(annotation, ("something else", "something else"))
    return several if many else one


def _near_choice(place: _Place, value: object) -> str:
    choices = [str(choice) for choice in get_args(_without_none(place.annotation)) if isinstance(choice, str)]
    near = difflib.get_close_matches(str(value).lower(), choices, 1, 0.6)
    return f'; did you mean "{near[0]}"?' if near else ""


def _other_unit(place: _Place, value: object) -> str:
    """Return a hint at the unit if a number is plainly in millimetres or degrees."""
    bound = _bounds(place)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return ""
    try:
        number = float(value)  # a variable of the environment is text
    except ValueError:
        return ""
    low, high = bound.get("ge", bound.get("gt", -math.inf)), bound.get("le", bound.get("lt", math.inf))
    return unit_hint(place.keys[-1], number, low, high)


def _one_of(names: list[str]) -> str:
    quoted = [f'"{name}"' for name in names]
    return " or ".join([", ".join(quoted[:-1]), quoted[-1]]) if quoted[1:] else quoted[0]


def _number(value: Any) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _shown(value: object) -> str:
    text = str(value).lower() if isinstance(value, bool) else repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."


def _without_none(annotation: Any) -> Any:
    """`X` of `X | None`."""
    if get_origin(annotation) in (Union, types.UnionType):
        rest = [argument for argument in get_args(annotation) if argument is not types.NoneType]
        return rest[0] if len(rest) == 1 else annotation
    return annotation


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The sections that a field may be."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is Annotated:
        return _models(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [model for argument in get_args(annotation) for model in _models(argument)]
    return []


def _kinds(annotation: Any) -> dict[str, type[BaseModel]]:
    """The sections of a field that is one of several, by their `kind`."""
    models = _models(annotation)
    return {str(get_args(m.model_fields["kind"].annotation)[0]): m for m in models if "kind" in m.model_fields}
