"""Ray casting of a scene, for images of its surfaces."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.rendering.meshes import scene_meshes
from cell.simulation.scenes.scenes import StringScene

_OFF_SURFACE_M = 1e-4
"""Distance from a surface at which a ray to a light starts, so that the surface does not shade itself."""


@dataclass(frozen=True, eq=False)
class Hits:
    """First surfaces on rays."""

    is_hit: NDArray[np.bool_]
    """Rays (N,) that hit a surface. The other entries are meaningless without a hit."""
    part: NDArray[np.int64]
    """Index (N,) of the mesh in `meshes.scene_meshes`; -1 without a hit."""
    triangles: NDArray[np.int64]
    """Index (N,) of the triangle in its mesh."""
    in_triangle: NDArray[np.float32]
    """Barycentric coordinates (N, 2) for the second and the third corner."""
    normals: NDArray[np.float32]
    """Unit normals (N, 3) towards the ray's origin, scene frame."""
    points: NDArray[np.float32]
    """Points (N, 3), scene frame."""


class RayCaster:
    """A scene that rays are cast into. It is built once."""

    def __init__(self, scene: StringScene) -> None:
        """Build the meshes of the scene."""
        import open3d as o3d

        self._scene = o3d.t.geometry.RaycastingScene()
        for vertices, triangles in scene_meshes(scene):
            self._scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))

    def cast_rays(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Return what open3d's `cast_rays` returns, as arrays (...).

        Args:
            rays: Origin and direction of each ray (..., 6), scene frame. `t_hit` is in lengths of the direction.
        """
        import open3d as o3d

        hits = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        return {name: hit.numpy() for name, hit in hits.items()}

    def cast(self, origin: NDArray[np.float64], directions: NDArray[np.float32]) -> Hits:
        """Return the first surface on each ray.

        Args:
            origin: Common origin (3,) of the rays, scene frame.
            directions: Directions (N, 3), of any length.
        """
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3] = origin
        rays[:, 3:] = directions
        cast = self.cast_rays(rays)
        distance = cast["t_hit"]
        is_hit = np.isfinite(distance)
        normals = cast["primitive_normals"]
        # the normal of a mesh may be on either side
        side = -np.sign(np.einsum("ni,ni->n", normals, directions))
        return Hits(
            is_hit=is_hit,
            part=np.where(is_hit, cast["geometry_ids"].astype(np.int64), -1),
            triangles=cast["primitive_ids"].astype(np.int64),
            in_triangle=cast["primitive_uvs"],
            normals=normals * side[:, None],
            points=rays[:, :3] + np.where(is_hit, distance, np.float32(0))[:, None] * directions,
        )

    def is_shaded(self, hits: Hits, light: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points (N,) something hides from a light at the position (3,), scene frame."""
        import open3d as o3d

        start = hits.points + np.float32(_OFF_SURFACE_M) * hits.normals
        rays = np.empty((len(start), 6), dtype=np.float32)
        rays[:, :3] = start
        rays[:, 3:] = light.astype(np.float32) - start
        return self._scene.test_occlusions(o3d.core.Tensor.from_numpy(rays), tfar=1.0).numpy()
