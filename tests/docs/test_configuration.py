"""The page of configuration keys is complete, shows the right defaults and has an example that loads."""

import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from service.config.loader import ServiceConfig, load_config
from tests.docs.pages import DOCS, blocks

PAGE = DOCS / "integrator/configuration.md"
KINDS: dict[str, dict[str, type[BaseModel]]] = {
    "arm": {"simulated": SimulatedArm, "ur": URArm},
    "camera": {"simulated": SimulatedCamera, "oak": OakCamera},
}
WITHOUT_UNIT = {
    "port", "event_streams", "event_streams_each", "exposures", "views", "min_views", "time_factor", "seed", "errors",
    "iso", "ir_dots", "pose_error_seed",
}  # fmt: skip
"""Numbers that are counts, factors or shares."""


@dataclass(frozen=True)
class Row:
    """A key as the page shows it."""

    section: str
    """Empty for a key of the top level."""
    kind: str | None
    """The only kind of arm or camera that has the key; None for a key of all kinds."""
    key: str
    type: str
    default: str
    unit: str
    meaning: str
    variable: str

    @property
    def value(self) -> str | None:
        """The default in the form of a configuration file; None where the page shows no value."""
        return self.default.strip("`") if self.default.startswith("`") else None


def rows() -> Iterator[Row]:
    """Yield the rows of the page's tables."""
    section, kind, inside = "", None, False
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            section, kind = line.removeprefix("## "), None
            inside = section == "Top level" or section in ServiceConfig.model_fields
            section = "" if section == "Top level" else section
        elif line.startswith("### "):
            kind = line.partition(", ")[2]
        elif inside and line.startswith("| `"):
            key, kind_of_value, default, unit, meaning, variable = (c.strip() for c in line.strip("|").split(" | "))
            yield Row(section, kind, key.strip("`"), kind_of_value, default, unit, meaning, variable.strip("`"))


ROWS = list(rows())


def is_section(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def expected() -> set[tuple[str, str | None, str]]:
    """Return section, kind and key of all settings, from their classes."""
    found: set[tuple[str, str | None, str]] = set()
    for name, field in ServiceConfig.model_fields.items():
        if name in KINDS:
            models = KINDS[name]
            shared = set.intersection(*(set(model.model_fields) for model in models.values())) - {"kind", "host"}
            # Each kind of camera has its own `model` or `ir_dots`.
            shared -= {"model", "ir_dots"} if name == "camera" else set()
            found |= {(name, None, key) for key in shared}
            found |= {(name, kind, key) for kind, model in models.items() for key in set(model.model_fields) - shared}
        elif is_section(field.annotation):
            assert isinstance(field.annotation, type)
            found |= {(name, None, key) for key in field.annotation.model_fields}
        else:
            found.add(("", None, name))
    return found


def test_every_key_is_listed_once() -> None:
    shown = [(row.section, row.kind, row.key) for row in ROWS]
    assert len(shown) == len(set(shown))
    assert set(shown) == expected()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.variable)
def test_every_key_is_described(row: Row) -> None:
    assert row.meaning.endswith("."), "add a docstring below the field"
    assert row.meaning[0].isupper() or row.meaning[0] == "`"
    numeric = row.type.startswith(("integer", "number", "list of 2 numbers", "list of 3", "list of 6"))
    assert not numeric or row.unit or row.key in WITHOUT_UNIT, "add the unit to docs/generated/configuration.py"


def written(section: str, kind: str | None) -> str:
    """Return a configuration file with the defaults of a section, or of one kind of it."""
    lines = [f"[{section}]"] if section else []
    for row in ROWS:
        if row.section == section and row.kind in (None, kind) and row.value is not None:
            lines.append(f"{row.key} = {row.value}")
    if kind == "ur":
        lines += ['kind = "ur"', 'host = "192.168.1.10"', "[camera]", 'kind = "simulated"']
    if kind == "oak":
        lines += ['kind = "oak"']
    return "\n".join(lines)


@pytest.mark.parametrize("section", sorted({row.section for row in ROWS} - set(KINDS)))
def test_the_defaults_are_those_of_the_settings(section: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(written(section, None))
    assert tomllib.loads(file.read_text()) != {}
    loaded, defaults = load_config(file), ServiceConfig()
    assert loaded.model_dump() == defaults.model_dump()


@pytest.mark.parametrize(("section", "kind"), [(name, kind) for name, models in KINDS.items() for kind in models])
def test_the_defaults_of_each_kind_are_those_of_the_settings(section: str, kind: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(written(section, kind))
    given = {"host": "192.168.1.10"} if kind == "ur" else {}
    assert getattr(load_config(file), section) == KINDS[section][kind].model_validate({"kind": kind, **given})


@pytest.mark.parametrize("row", [row for row in ROWS if row.value is not None], ids=lambda row: row.variable)
def test_each_variable_sets_its_key(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)
    if row.kind is not None:
        monkeypatch.setenv(f"POINTCHAIN_{row.section.upper()}__KIND", row.kind)
    assert row.value is not None
    monkeypatch.setenv(row.variable, row.value.strip('"'))
    loaded: Any = load_config()
    section = getattr(loaded, row.section) if row.section else loaded
    assert row.key in section.model_fields_set
    assert row.variable == "POINTCHAIN_" + "__".join(filter(None, (row.section, row.key))).upper()
    monkeypatch.setenv(f"{row.variable}X", "1")
    with pytest.raises(ValueError, match="unknown setting"):
        load_config()


def test_the_example_configures_a_real_cell(tmp_path: Path) -> None:
    (example,) = (block for block in blocks(PAGE) if block.language == "toml")
    file = tmp_path / "cell.toml"
    file.write_text(example.text)
    config = load_config(file)
    assert (config.arm.kind, config.camera.kind) == ("ur", "oak")
    assert config.data_dir == Path("/var/lib/pointchain")
    assert config.cell.hand_eye.active_file == config.data_dir / "calibration/hand_eye.json"


def test_the_page_has_all_kinds() -> None:
    for section, models in KINDS.items():
        kinds = {get_args(model.model_fields["kind"].annotation)[0] for model in models.values()}
        assert kinds == {row.kind for row in ROWS if row.section == section} - {None}
