"""Export of the points of a model: as a point cloud with edges (PLY), and as a table (CSV)."""

import csv
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recognition.model.model import SCHEMA

VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("chain", "<i4"),
        ("arc_length_m", "<f4"),
        ("radius_m", "<f4"),
        ("sigma_m", "<f4"),
        ("views", "<i4"),
    ]
)
"""Properties of a point. All viewers read float32; its resolution is 0.1 micrometres at one metre."""
EDGE = np.dtype([("vertex1", "<i4"), ("vertex2", "<i4")])
"""Edge from a point to the next, as indices of vertices."""
_PLY_NAMES = {"<f4": "float", "<i4": "int"}
COLUMNS = ("chain", "point", "x_m", "y_m", "z_m", "arc_length_m", "sigma_m", "views", "radius_m")


def to_point_ply(model: Mapping[str, Any]) -> bytes:
    """Return the chains of a model document as a binary PLY file, with an edge from each point to the next."""
    vertices, edges = [np.zeros(0, VERTEX)], [np.zeros(0, EDGE)]
    for chain in model["chains"]:
        first = sum(len(block) for block in vertices)
        vertices.append(_vertices(chain))
        edges.append(_edges(first, len(chain["points"]), chain["closed"]))
    blocks = {"vertex": np.concatenate(vertices), "edge": np.concatenate(edges)}
    lines = ["ply", "format binary_little_endian 1.0", "comment metres, base frame", f"comment {SCHEMA}"]
    for name, block in blocks.items():
        lines.append(f"element {name} {len(block)}")
        fields = block.dtype.fields or {}
        lines.extend(f"property {_PLY_NAMES[kind[0].str]} {field}" for field, kind in fields.items())
    header = "\n".join([*lines, "end_header", ""])
    return header.encode() + b"".join(block.tobytes() for block in blocks.values())


def to_csv(model: Mapping[str, Any]) -> bytes:
    """Return the chains of a model document as a table, with a header and one row per point."""
    text = io.StringIO(newline="")
    table = csv.writer(text)
    table.writerow(COLUMNS)
    for chain in model["chains"]:
        values = zip(chain["points"], chain["arc_length_m"], chain["sigma_m"], chain["views"], strict=True)
        for k, (point, arc_length_m, sigma_m, views) in enumerate(values):
            table.writerow((chain["id"], k, *point, arc_length_m, sigma_m, views, chain["radius_m"]))
    return text.getvalue().encode()


def _vertices(chain: Mapping[str, Any]) -> NDArray[np.void]:
    points = np.asarray(chain["points"], dtype=np.float64).reshape(-1, 3)
    block = np.zeros(len(points), VERTEX)
    block["x"], block["y"], block["z"] = points.T
    block["chain"], block["radius_m"] = chain["id"], chain["radius_m"]
    for name in ("arc_length_m", "sigma_m", "views"):
        block[name] = chain[name]
    return block


def _edges(first: int, count: int, closed: bool) -> NDArray[np.void]:
    block = np.zeros(count if closed else max(count - 1, 0), EDGE)
    block["vertex1"] = first + np.arange(len(block))
    block["vertex2"] = first + (np.arange(len(block)) + 1) % max(count, 1)
    return block
