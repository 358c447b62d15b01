"""RTDE recipes: the variables of a package and their encoding."""

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
    """Recipe of the packages that the controller sends to a client."""

    types: tuple[str, ...]
    """RTDE types of the variables; NOT_FOUND for unknown ones."""
    layout: struct.Struct
    """Encoding of the package, header included."""
    values: list[Any]
    """Values of the last package, header included; updated in place by `package`."""
    sources: tuple[_Source, ...]
    """Sources of the variables that change: index into `values`, length (0 for a scalar) and getter."""
    recipe_id: int
    """Number of the recipe in the package header."""

    @property
    def valid(self) -> bool:
        """Whether the controller knows every variable."""
        return "NOT_FOUND" not in self.types

    def package(self) -> bytes:
        """Return the package with the current values, header included."""
        values = self.values
        for index, length, source in self.sources:
            if length:
                values[index : index + length] = source()
            else:
                values[index] = source()
        return self.layout.pack(*values)


def output_recipe(robot: Robot, names: Sequence[str], version: int, software: tuple[int, ...]) -> OutputRecipe:
    """Return the recipe of the named variables.

    Args:
        robot: Source of the values.
        names: Names of the variables.
        version: Version of the protocol. Packages of version 1 have no recipe id.
        software: Software version of the controller, which lacks the variables of newer versions.
    """
    recipe_id = 1
    pattern = ">HBB" if version > 1 else ">HB"
    values: list[Any] = [0, DATA, recipe_id][: len(pattern) - 1]
    types: list[str] = []
    sources: list[_Source] = []
    for name in names:
        found = rtde_variables.output(robot, name, software)
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
    """Merge the sources of neighbouring registers: ur_rtde reads dozens of them 500 times a second."""
    joined: list[_Source] = []
    for index, length, source in sources:
        last = joined[-1][2] if joined else None
        if (
            isinstance(source, rtde_variables.RegisterSource)
            and isinstance(last, rtde_variables.RegisterSource)
            and source.bank is last.bank
            and source.first == last.first + last.count
            and index == joined[-1][0] + last.count
        ):
            first, count = last.first, last.count + 1
            joined[-1] = joined[-1][0], count, rtde_variables.RegisterSource(last.bank, first, count)
        else:
            joined.append((index, length, source))
    return joined


@dataclass(frozen=True)
class InputRecipe:
    """Recipe of the packages that a client sends to the controller."""

    names: tuple[str, ...]
    """Names of the variables."""
    types: tuple[str, ...]
    """RTDE types of the variables; NOT_FOUND for unknown ones, IN_USE for those that another client writes."""
    layout: struct.Struct
    """Encoding of the values, without the header."""

    @property
    def valid(self) -> bool:
        """Whether every variable is known and free."""
        return not {"NOT_FOUND", "IN_USE"} & set(self.types)

    def values(self, data: bytes) -> dict[str, Any]:
        """Decode the values by name; vectors as tuples."""
        flat = iter(self.layout.unpack(data))
        return {
            name: tuple(next(flat) for _ in range(int(kind[6]))) if kind.startswith("VECTOR") else next(flat)
            for name, kind in zip(self.names, self.types, strict=True)
        }


def input_recipe(names: Sequence[str], in_use: Callable[[str], bool]) -> InputRecipe:
    """Return the recipe of the named variables; `in_use` returns whether another client writes one."""
    types = []
    for name in names:
        kind = rtde_variables.input_type(name)
        types.append("NOT_FOUND" if kind is None else "IN_USE" if in_use(name) else kind)
    layout = struct.Struct(">" + "".join(rtde_variables.FORMATS.get(kind, "") for kind in types))
    return InputRecipe(tuple(names), tuple(types), layout)
