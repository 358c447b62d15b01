"""Points of PLY files, ASCII or binary. Open3D reads them; it is imported only when a file is read."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.cloud.errors import CloudError

MAX_HEADER_BYTES = 64 << 10
MAX_POINTS = 20_000_000
"""Eighty images of 640x400 pixels."""
FARTHEST_M = 20.0
"""No point of a cell is farther from the base frame; larger numbers are millimetres."""
COORDINATES = ("x", "y", "z")
BYTES = {
    "char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8,
    "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4, "float64": 8,
}  # fmt: skip
"""Size of each scalar type of PLY."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of a PLY file."""

    points: NDArray[np.float64]
    """(N, 3), base frame, metres; finite."""
    views: NDArray[np.int64] | None
    """(N,) number of the viewpoint of each point; None: the file does not have it."""
    notes: tuple[str, ...]
    """Messages about what was ignored."""


def read_cloud(path: Path, view_property: str | None = None, usual_property: str | None = None) -> Cloud:
    """Return the points in the file.

    Args:
        path: The PLY file.
        view_property: Property of each point that numbers its viewpoint; None: `usual_property`.
        usual_property: The same, but used only if the file has it.

    Raises:
        CloudError: The file cannot be read, is no PLY file, or is damaged.
    """
    count, properties, elements = _header(path)
    if view_property is None and usual_property in properties:
        view_property = usual_property
    if view_property is not None and view_property not in properties:
        others = [name for name in properties if name not in COORDINATES]
        raise CloudError(
            f"{path} has no property {view_property!r}; its properties are {', '.join(others) or 'x, y, z'}"
        )
    import open3d as o3d

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        read = o3d.t.io.read_point_cloud(path).point
    points = read.positions.numpy().astype(np.float64) if "positions" in read else np.zeros((0, 3))
    if len(points) != count:
        raise CloudError(f"{path} is damaged or cut off: its header has {count} points, {len(points)} can be read")
    finite = np.isfinite(points).all(axis=1)
    views = None
    if view_property is not None:
        views = _view_numbers(read[view_property].numpy().ravel()[finite], path, view_property)
    points = points[finite]
    if len(points) == 0:
        raise CloudError(f"{path} has no points with finite coordinates")
    if np.abs(points).max() > FARTHEST_M:
        raise CloudError(
            f"{path} has a point {np.abs(points).max():.4g} from the base frame, more than {FARTHEST_M:g} m: give "
            "points in metres; these look like millimetres"
        )
    ignored = [name for name in properties if name not in (*COORDINATES, view_property)]
    notes = [f"{path.name}: {count - len(points)} points are NaN or infinite: they were dropped"] * (
        len(points) < count
    )
    notes += [f"{path.name}: these properties were ignored: {', '.join(ignored)}"] * bool(ignored)
    notes += [f"{path.name} is a mesh: its {name} elements were ignored" for name in elements if name != "vertex"]
    return Cloud(points, views, tuple(notes))


def _header(path: Path) -> tuple[int, list[str], list[str]]:
    """Return the number of points, the names of their properties, and the names of the elements that have members."""
    try:
        with path.open("rb") as file:
            head, end, _ = file.read(MAX_HEADER_BYTES).partition(b"end_header")
            body_bytes = path.stat().st_size - len(head) - len(end)
    except OSError as error:
        raise CloudError(f"{path} cannot be read: {error.strerror or error}") from error
    lines = head.decode("ascii", errors="replace").splitlines()
    if not lines or lines[0].strip() != "ply" or not end:
        raise CloudError(f"{path} is not a PLY file: save the point cloud as PLY")
    counts: dict[str, int] = {}
    properties: list[str] = []
    is_text = any(line.split()[:2] == ["format", "ascii"] for line in lines)
    row_bytes, element = 0, ""
    for line in lines[1:]:
        match line.split():
            case ["element", element, number] if number.isdigit():
                counts[element] = int(number)
            case ["property", *kind, name] if element == "vertex":
                properties.append(name)
                row_bytes += 2 if is_text else BYTES.get(kind[0], 1)  # as text, a digit and a space at least
    if not set(COORDINATES) <= set(properties) or not counts.get("vertex"):
        raise CloudError(f"{path} has no points: an element vertex with x, y and z is needed")
    if counts["vertex"] > MAX_POINTS:
        raise CloudError(f"{path} has {counts['vertex']} points; at most {MAX_POINTS} are allowed: thin them evenly")
    # Open3D fills what is missing with zeros.
    if body_bytes < counts["vertex"] * row_bytes:
        raise CloudError(f"{path} is damaged or cut off: it is too short for {counts['vertex']} points; copy it again")
    return counts["vertex"], properties, [name for name, number in counts.items() if number]


def _view_numbers(values: NDArray[np.generic], path: Path, name: str) -> NDArray[np.int64]:
    numbers = values.astype(np.float64)
    if not (np.isfinite(numbers).all() and (numbers == np.rint(numbers)).all() and (numbers >= 0).all()):
        raise CloudError(f"{path}: the property {name!r} must number the viewpoints 0, 1, 2 ...; it has other values")
    return numbers.astype(np.int64)
