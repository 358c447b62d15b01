"""RTDE's recipes: which variables a package holds, and its bytes."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from cell.simulation.ur_controller.robot.robot import Robot
from cell.simulation.ur_controller.servers import rtde_variables

DATA = ord("U")

_Source = tuple[int, int, Callable[[], Any]]


@dataclass(frozen=True)
class OutputRecipe:
    """What the controller sends."""

    types: tuple[str, ...]
    """Of the variables, on the wire; NOT_FOUND for unknown ones."""
    layout: struct.Struct
    values: list[Any]
    """The package's values, head included, as they were last."""
    sources: tuple[_Source, ...]
    """Of each variable that changes: its place among the values, how many they are (0 for one that is no vector), and
    its value now."""
    recipe_id: int

    @property
    def valid(self) -> bool:
        """The controller knows every variable."""
        return "NOT_FOUND" not in self.types

    def package(self) -> bytes:
        """The whole package with the values of now."""
        values = self.values
        for place, length, source in self.sources:
            if length:
                values[place : place + length] = source()
            else:
                values[place] = source()
        return self.layout.pack(*values)


def output_recipe(robot: Robot, names: Sequence[str], version: int) -> OutputRecipe:
    """The recipe of these variables; unknown ones have the type NOT_FOUND. Version 1 knows no recipe id."""
    recipe_id = 1
    pattern = ">HBB" if version > 1 else ">HB"
    values: list[Any] = [0, DATA, recipe_id][: len(pattern) - 1]
    types: list[str] = []
    sources: list[_Source] = []
    for name in names:
        found = rtde_variables.output(robot, name)
        if found is None:
            types.append("NOT_FOUND")
            continue
        kind, source = found
        types.append(kind)
        pattern += rtde_variables.FORMATS[kind]
        length = int(kind[6]) if kind.startswith("VECTOR") else 0
        if callable(source):
            sources.append((len(values), length, source))
            source = [0] * length if length else 0
        values.extend(source if isinstance(source, Sequence) else [source])
    layout = struct.Struct(pattern)
    values[0] = layout.size
    return OutputRecipe(tuple(types), layout, values, tuple(_joined(sources)), recipe_id)


def _joined(sources: list[_Source]) -> list[_Source]:
    """Neighbouring registers are read at once: ur_rtde asks for dozens of them, 500 times a second."""
    joined: list[_Source] = []
    for place, length, source in sources:
        last = joined[-1][2] if joined else None
        if (
            isinstance(source, rtde_variables.RegisterSource)
            and isinstance(last, rtde_variables.RegisterSource)
            and source.bank is last.bank
            and source.first == last.first + last.count
            and place == joined[-1][0] + last.count
        ):
            first, count = last.first, last.count + 1
            joined[-1] = joined[-1][0], count, rtde_variables.RegisterSource(last.bank, first, count)
        else:
            joined.append((place, length, source))
    return joined


@dataclass(frozen=True)
class InputRecipe:
    """What a client sends."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    layout: struct.Struct

    @property
    def valid(self) -> bool:
        """Every variable is known, and no other client's."""
        return not {"NOT_FOUND", "IN_USE"} & set(self.types)

    def values(self, data: bytes) -> dict[str, Any]:
        """The variables' values; of vectors as tuples."""
        flat = iter(self.layout.unpack(data))
        return {
            name: tuple(next(flat) for _ in range(int(kind[6]))) if kind.startswith("VECTOR") else next(flat)
            for name, kind in zip(self.names, self.types, strict=True)
        }


def input_recipe(names: Sequence[str], in_use: Callable[[str], bool]) -> InputRecipe:
    """The recipe of these variables; unknown ones have the type NOT_FOUND, those of other clients IN_USE."""
    types = []
    for name in names:
        kind = rtde_variables.input_type(name)
        types.append("NOT_FOUND" if kind is None else "IN_USE" if in_use(name) else kind)
    layout = struct.Struct(">" + "".join(rtde_variables.FORMATS.get(kind, "") for kind in types))
    return InputRecipe(tuple(names), tuple(types), layout)
