"""Triangle meshes of what lies on the table."""

import numpy as np
from numpy.typing import NDArray

from cell.simulation.clutter import Box

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (N, 3), metres, and triangles (M, 3)."""

TABLE_HALF_M = 0.8
"""Half the side of the square table."""


def tube(curve: NDArray[np.float64], radius_m: float, sides: int = 40) -> Mesh:
    """A tube of a radius about the polyline `curve` (N, 3), with flat ends, as of a cut cable.

    Its corners lie as far outside the true surface as the middles of its sides lie inside: with 40 sides
    either is 0.15 % of the radius.
    """
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # Strings on a table never stand upright, so that the vertical gives every ring its frame, without twist.
    side = np.cross(tangent, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = 2 * np.pi * np.arange(sides) / sides
    corner_m = radius_m * 2 / (1 + np.cos(np.pi / sides))
    circle = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    rings = curve[:, None] + corner_m * circle
    count = len(curve)
    vertices = np.vstack([rings.reshape(-1, 3), curve[:1], curve[-1:]])
    ring, corner = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + corner, ring * sides + (corner + 1) % sides
    walls = np.stack([np.stack([a, b, b + sides], -1), np.stack([a, b + sides, a + sides], -1)], 2)
    k = np.arange(sides)
    first = np.column_stack([np.full(sides, count * sides), (k + 1) % sides, k])
    last = np.column_stack([np.full(sides, count * sides + 1), k, (k + 1) % sides]) + (0, 1, 1) * np.array(
        (count - 1) * sides
    )
    triangles = np.vstack([walls.reshape(-1, 3), first, last])
    return vertices.astype(np.float32), triangles.astype(np.uint32)


def table() -> Mesh:
    """The square table z = 0."""
    h = TABLE_HALF_M
    vertices = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], dtype=np.float32)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def box_mesh(box: Box) -> Mesh:
    """The box, standing on the table."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * box.size_m
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    vertices = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + (*box.centre_m, 0.0)
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = [triangle for a, b, c_, d in sides for triangle in ((a, b, c_), (a, c_, d))]
    return vertices.astype(np.float32), np.array(triangles, dtype=np.uint32)
