"""Generate the page of all configuration keys from the settings classes and their field docstrings."""

import ast
import inspect
import itertools
import textwrap
import types
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from cell.config.gripper_config import GripperSettings
from cell.config.scan_views import MAX_VIEWPOINTS, MIN_VIEWPOINTS, Views
from recognition.grasping.gripper import Gripper
from service.config.loader import PREFIX, ServiceConfig

UNITS = {
    "rad_s2": "rad/s²",
    "m_s2": "m/s²",
    "rad_s": "rad/s",
    "m_s": "m/s",
    "rad": "rad",
    "hz": "Hz",
    "us": "µs",
    "days": "days",
    "bytes": "bytes",
    "fps": "images/s",
    "width": "px",
    "height": "px",
    "px": "px",
    "s": "s",
    "m": "m",
}
"""Units by the last parts of a key's name, the longest first."""

WIDTH = 120

DATA_DIR = "the platform's, `~/.local/share/pointchain` on Linux"

INTRODUCTION = """\
# Configuration

This page is for integrators. It lists every configuration key with its type, default, unit, meaning and environment
variable. It is generated from the settings classes; do not edit it by hand.

## How the configuration is read

- `pointchain serve`, `scan`, `check`, `viewpoints`, `calibrate run`, `calibrate verify`, `calibrate activate`, `token`,
  `audit` and `doctor` take the file as `--config cell.toml`. `recognise` reads only the gripper from it.
- The variable `POINTCHAIN_CONFIG` names the file when `--config` does not.
- A value comes from the first of these sources that has it: command line, environment variable, file, default.
- The variable of a key is `POINTCHAIN_` and the key in capitals, with two underscores between section and key:
  `POINTCHAIN_ARM__HOST`. Lists are JSON: `POINTCHAIN_WORKSPACE__X_M='[0.2, 0.6]'`. An empty variable counts as not set.
- An unknown key, section or variable is an error. The message names it and gives one hint: a similar name that is
  known, the section or kind that has such a key, or the list of all known names.
- A running service does not read the file again: restart it after a change. [Test the result](commissioning.md) with
  `pointchain check --config cell.toml`.

Without any configuration, the cell is [the simulated one](simulated-cell.md).

## Example: a real cell

```toml
data_dir = "/var/lib/pointchain"

[arm]
kind = "ur"
host = "192.168.1.10"
model = "ur5e"

[camera]
kind = "oak"
product = "oak-d-pro"

[hand_eye]
rough_xyz_m = [0.03, -0.06, 0.05]

[workspace]
x_m = [0.30, 0.66]
y_m = [-0.18, 0.18]
top_m = 0.12

[mounting]
table_z_m = -0.012
obstacles_m = [[[0.5, 0.5, 0.0], [0.9, 0.9, 0.3]]]

[scan]
string_radius_m = 0.0042

[security]
allowed_hosts = ["cell.example.com"]

[retention]
max_age_days = 90
```

In a container, omit the top-level keys `host`, `port` and `data_dir`, and `hand_eye.file`. See
[Run it in a container](container.md).

## Rules between keys

- With `arm.kind = "ur"`, `camera.kind` must be given. `"simulated"` is allowed, to rehearse with URSim.
- The workspace must not contain the base of the arm.
- `scan.min_views` must not exceed `scan.views`.
- `camera.fps` of an OAK camera must not exceed the limit of its product, resolution and `extended_disparity`, and
  `camera.exposure_us` must not be longer than one image takes at that rate.
  See [Frame rate and exposures](exposures.md).
"""


class Key(NamedTuple):
    """One configuration key as the page shows it."""

    name: str
    kind: str
    default: str
    unit: str
    meaning: str
    variable: str


def page() -> str:
    """Return the page as Markdown."""
    parts = [INTRODUCTION, "## Top level\n", _table(_keys(ServiceConfig, (), _is_plain))]
    docs = field_docstrings(ServiceConfig)
    for name, field in ServiceConfig.model_fields.items():
        models = sections(field.annotation)
        if not models:
            continue
        shared = _shared_base(models)
        lead = docs.get(name) or inspect.getdoc(shared) or ""
        parts.append(f"## {name}\n\n{_paragraph(lead)}\n")
        parts.append(_table(_keys(shared, (name,), lambda _: True)))
        for model in models if len(models) > 1 else []:
            kind = get_args(model.model_fields["kind"].annotation)[0]
            parts.append(f"### {name}, {kind}\n\n{_paragraph(inspect.getdoc(model) or '')}\n")
            own = set(model.model_fields) - set(shared.model_fields)
            parts.append(_table(_keys(model, (name,), own.__contains__)))
    return "\n".join(parts)


def sections(annotation: Any) -> list[type[BaseModel]]:
    """Return the settings classes that a field may hold; none for a plain value."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Annotated, Union, types.UnionType):
        return [model for part in get_args(annotation) for model in sections(part)]
    return []


def field_docstrings(model: type) -> dict[str, str]:
    """Return the docstring below each field of a class and of its bases, read from the source."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if base.__module__.split(".")[0] in ("service", "cell", "recognition"):
            found |= _own_docstrings(base)
    return found


def _own_docstrings(model: type) -> dict[str, str]:
    tree = ast.parse(Path(inspect.getfile(model)).read_text())
    (body,) = (node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == model.__name__)
    return {
        field.target.id: _one_line(text.value.value)
        for field, text in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _shared_base(models: list[type[BaseModel]]) -> type[BaseModel]:
    """Return the class itself, or the nearest base that all of them have."""
    return next(base for base in models[0].__mro__ if all(issubclass(model, base) for model in models))


def _is_plain(name: str) -> bool:
    return not sections(ServiceConfig.model_fields[name].annotation)


def _keys(model: type[BaseModel], path: tuple[str, ...], wanted: Any) -> list[Key]:
    # The gripper's fields are those of the recognition package and documented there.
    docs = (field_docstrings(Gripper) if model is GripperSettings else {}) | field_docstrings(model)
    return [
        Key(
            name,
            _type(field),
            _default(name, field),
            _unit(name),
            docs.get(name, ""),
            PREFIX + "__".join((*path, name)).upper(),
        )
        for name, field in model.model_fields.items()
        if wanted(name)
    ]


def _table(keys: Iterable[Key]) -> str:
    rows = ["| key | type | default | unit | meaning | variable |", "|---|---|---|---|---|---|"]
    for key in keys:
        cells = (f"`{key.name}`", key.kind, key.default, key.unit, key.meaning, f"`{key.variable}`")
        rows.append(f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |")
    return "\n".join(rows) + "\n"


def _type(field: FieldInfo) -> str:
    if field.annotation == Views:
        return f'integer, ≥ {MIN_VIEWPOINTS}, ≤ {MAX_VIEWPOINTS}, or `"auto"`'
    annotation = _without_none(field.annotation)
    if get_origin(annotation) is Literal:
        values = [f'`"{value}"`' for value in get_args(annotation)]
        return values[0] if len(values) == 1 else f"one of {', '.join(values)}"
    return _name(annotation) + _bounds(field)


def _name(annotation: Any) -> str:
    simple = {str: "text", int: "integer", float: "number", bool: "true or false", Path: "path"}
    if annotation in simple:
        return simple[annotation]
    if get_origin(annotation) is tuple:
        parts = get_args(annotation)
        if parts[-1] is Ellipsis:
            return "list of boxes" if get_origin(parts[0]) is tuple else f"list of {_name(parts[0])}"
        return f"list of {len(parts)} {_name(parts[0])}s"
    raise TypeError(f"no name for the type {annotation}: add it")


def _bounds(field: FieldInfo) -> str:
    words = []
    for bound in field.metadata:
        match bound:
            case Gt(gt=value):
                words.append(f"> {value:g}")
            case Ge(ge=value):
                words.append(f"≥ {value:g}")
            case Lt(lt=value):
                words.append(f"< {value:g}")
            case Le(le=value):
                words.append(f"≤ {value:g}")
    return f", {', '.join(words)}" if words else ""


def _without_none(annotation: Any) -> Any:
    if get_origin(annotation) in (Union, types.UnionType):
        (annotation,) = (part for part in get_args(annotation) if part is not types.NoneType)
    return annotation


def _default(name: str, field: FieldInfo) -> str:
    if name == "data_dir":
        return DATA_DIR
    if field.is_required():
        return "required"
    return toml(field.default)


def toml(value: Any) -> str:
    """Return a default as the configuration file would write it."""
    match value:
        case None:
            return "not set"
        case bool():
            return f"`{str(value).lower()}`"
        case str():
            return f'`"{value}"`'
        case tuple():
            return f"`[{', '.join(toml(part).strip('`') for part in value)}]`"
        case _:
            return f"`{value}`"


def _unit(name: str) -> str:
    return next((unit for suffix, unit in UNITS.items() if name == suffix or name.endswith(f"_{suffix}")), "")


def _paragraph(text: str) -> str:
    return textwrap.fill(_one_line(text), WIDTH)


def _one_line(text: str) -> str:
    return " ".join(text.split())
