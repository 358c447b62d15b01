"""Triangle meshes of the objects on the table."""

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.clutter import Box, Cloth, Clump, Rod
from cell.simulation.scenes.planar_crossings import is_closed
from cell.simulation.scenes.scenes import StringScene

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (N, 3), metres, and triangles (M, 3)."""

TABLE_HALF_M = 0.8
"""Half the side length of the square table."""

TUBE_SIDES = 40
"""Number of faces around a tube."""


def scene_meshes(scene: StringScene) -> list[Mesh]:
    """Return the meshes of a scene: the strings in their order, then the table and the clutter."""
    strings = [tube(curve, radius_m) for curve, radius_m in zip(scene.curves, scene.radii_m, strict=True)]
    clutter = [*map(box_mesh, scene.boxes), *map(clump_mesh, scene.clumps)]
    return [*strings, table(), *clutter, *map(rod_mesh, scene.rods), *map(cloth_mesh, scene.cloths)]


def tube(curve: NDArray[np.float64], radius_m: float, sides: int = TUBE_SIDES) -> Mesh:
    """Return a tube around a polyline, with flat ends or closed to a ring.

    The vertices are as far outside the true surface as the middles of the faces are inside. With 40 sides, both are
    0.15 % of the radius. Two triangles in sequence are one face, and `sides` faces in sequence are one ring.

    Args:
        curve: Centre line (N, 3).
        radius_m: Radius of the tube.
        sides: Number of faces around the tube.
    """
    closed = is_closed(curve)
    if closed:
        tangent = np.roll(curve[:-1], -1, axis=0) - np.roll(curve[:-1], 1, axis=0)
        tangent = np.vstack([tangent, tangent[:1]])
    else:
        tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # strings on a table are never vertical, so the vertical gives each ring a frame without twist
    side = np.cross(tangent, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    angle = 2 * np.pi * np.arange(sides) / sides
    corner_m = radius_m * 2 / (1 + np.cos(np.pi / sides))
    circle = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    rings = (curve[:, None] + corner_m * circle).reshape(-1, 3)
    count = len(curve)
    ring, corner = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + corner, ring * sides + (corner + 1) % sides
    walls = np.stack([np.stack([a, b, b + sides], -1), np.stack([a, b + sides, a + sides], -1)], 2).reshape(-1, 3)
    if closed:
        return rings.astype(np.float32), walls.astype(np.uint32)
    k = np.arange(sides)
    first = np.column_stack([np.full(sides, count * sides), (k + 1) % sides, k])
    last = np.column_stack([np.full(sides, count * sides + 1), k, (k + 1) % sides]) + (0, 1, 1) * np.array(
        (count - 1) * sides
    )
    vertices = np.vstack([rings, curve[:1], curve[-1:]])
    return vertices.astype(np.float32), np.vstack([walls, first, last]).astype(np.uint32)


def table() -> Mesh:
    """Return the square table z = 0."""
    h = TABLE_HALF_M
    vertices = np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], dtype=np.float32)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def box_mesh(box: Box) -> Mesh:
    """Return a box that stands on the table."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * box.size_m
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    vertices = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + (*box.centre_m, 0.0)
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = [triangle for a, b, c_, d in sides for triangle in ((a, b, c_), (a, c_, d))]
    return vertices.astype(np.float32), np.array(triangles, dtype=np.uint32)


def clump_mesh(clump: Clump, cell_m: float = 0.003) -> Mesh:
    """Return a clump: a dome with a surface that is rough at all scales down to a few millimetres."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(clump.seed)
    half = int(np.ceil(clump.radius_m / cell_m)) + 1
    x, y = np.meshgrid(*(np.arange(-half, half + 1, dtype=np.float64) * cell_m,) * 2)
    rough = sum(
        gaussian_filter(rng.standard_normal(x.shape), blur, mode="wrap") * blur * share
        for blur, share in ((1.0, 0.9), (2.5, 1.2), (5.0, 1.6))
    )
    dome = 1 - (x**2 + y**2) / clump.radius_m**2
    z = clump.height_m * np.sqrt(np.maximum(dome, 0.0)) * np.clip(0.65 + rough, 0.05, 1.0)
    return _relief(x + clump.centre_m[0], y + clump.centre_m[1], z)


def rod_mesh(rod: Rod, sides: int = 40) -> Mesh:
    """Return a rod. Its vertices are as far outside the true surface as the middles of the faces are inside."""
    start, end = np.array(rod.start_m), np.array(rod.end_m)
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.arange(sides) / sides
    corner_m = rod.radius_m * 2 / (1 + np.cos(np.pi / sides))
    circle = corner_m * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side))
    vertices = np.vstack([start + circle, end + circle, start, end])
    k = np.arange(sides)
    following = (k + 1) % sides
    first, last = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    triangles = [
        np.column_stack([k, following, following + sides]),
        np.column_stack([k, following + sides, k + sides]),
        np.column_stack([first, following, k]),
        np.column_stack([last, k + sides, following + sides]),
    ]
    return vertices.astype(np.float32), np.vstack(triangles).astype(np.uint32)


def cloth_mesh(cloth: Cloth, cell_m: float = 0.001) -> Mesh:
    """Return a cloth: a square of constant thickness, on which each fold is a ridge with a bell curve as section."""
    from scipy.spatial import KDTree

    half = int(np.ceil(cloth.half_m / cell_m))
    x, y = np.meshgrid(*(np.arange(-half, half + 1, dtype=np.float64) * cell_m,) * 2)
    x, y = x + cloth.centre_m[0], y + cloth.centre_m[1]
    z = np.full(x.shape, cloth.thickness_m)
    for fold in cloth.folds:
        distance = KDTree(fold).query(np.stack([x, y], axis=-1))[0]
        z = np.maximum(z, cloth.thickness_m + cloth.fold_height_m * np.exp(-((distance / cloth.fold_width_m) ** 2) / 2))
    z[[0, -1]], z[:, [0, -1]] = 0.0, 0.0
    return _relief(x, y, z)


def _relief(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> Mesh:
    """Return the surface of heights (M, N) over a grid, without its parts at the height 0, which are the table."""
    vertices = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    number = np.arange(z.size).reshape(z.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    triangles = triangles[z.ravel()[triangles].max(axis=1) > 0]
    return vertices.astype(np.float32), triangles.astype(np.uint32)
