"""Reflectance of the surfaces of a scene."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cell.simulation.rendering.appearance import Appearance, Texture, sheath_texture, table_texture
from cell.simulation.rendering.meshes import TUBE_SIDES
from cell.simulation.rendering.ray_caster import Hits
from cell.simulation.scenes.scenes import StringScene

CLUTTER = 0.30
"""Mean reflectance of objects beside the strings."""

_TEXTURE_STREAM = 10
"""Stream of a seed from which the textures are drawn."""
_NEXT_STRING_M = 0.05
"""Offset between the textures of two strings, so that they differ."""


class Materials:
    """Surfaces of a scene, with textured strings, table and clutter."""

    def __init__(self, scene: StringScene, appearance: Appearance, seed: int) -> None:
        """Create the materials. The textures are drawn when they are first needed, because this takes time.

        Args:
            scene: Scene whose meshes the rays hit.
            appearance: Materials.
            seed: Seed of the textures.
        """
        self._appearance = appearance
        self._seed = seed
        self._clutter_share = CLUTTER / appearance.table_reflectance
        self._radii_m = scene.radii_m
        self._arc_lengths = [_arc_length(curve) for curve in scene.curves]

    @cached_property
    def _textures(self) -> tuple[Texture, Texture]:
        """Textures of the table and of the sheath."""
        rng = np.random.default_rng([self._seed, _TEXTURE_STREAM])
        table = table_texture(self._appearance, rng)
        return table, sheath_texture(self._appearance, rng)

    def reflectance(self, hits: Hits) -> NDArray[np.float32]:
        """Return the reflectance (N,) of the surface of each hit, 0 without a hit."""
        strings = len(self._arc_lengths)
        table, _ = self._textures
        values = np.zeros(len(hits.part), dtype=np.float32)
        flat = hits.part >= strings
        x = hits.points[flat, 0]
        y = hits.points[flat, 1]
        # the height shifts the texture on the sides of objects, where x and y stay the same
        values[flat] = table.at(x, y + hits.points[flat, 2])
        values[hits.part > strings] *= np.float32(self._clutter_share)
        for number in range(strings):
            on_string = hits.part == number
            if on_string.any():
                values[on_string] = self._on_string(hits, on_string, number)
        return values

    def _on_string(self, hits: Hits, on_string: NDArray[np.bool_], number: int) -> NDArray[np.float32]:
        """Return the reflectance of the hits on a string, by arc length and arc around the string.

        `meshes.tube` has two triangles per face: (a, b, d) and (a, d, c). The corners a and b are on one ring, c and d
        on the next.
        """
        arc_length = self._arc_lengths[number]
        triangle = hits.triangles[on_string]
        second = hits.in_triangle[on_string, 0]
        third = hits.in_triangle[on_string, 1]
        face = triangle // 2
        # the triangles of flat ends come after those of all rings
        ring = np.minimum(face // TUBE_SIDES, len(arc_length) - 2)
        is_first = triangle % 2 == 0
        along = np.where(is_first, third, second + third)
        around = np.where(is_first, second + third, second)
        start = arc_length[ring]
        end = arc_length[ring + 1]
        u = start + along * (end - start)
        v = (face % TUBE_SIDES + around) * (2 * np.pi * self._radii_m[number] / TUBE_SIDES) + number * _NEXT_STRING_M
        _, sheath = self._textures
        return sheath.at(u.astype(np.float32), v.astype(np.float32))


def _arc_length(curve: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the arc length (N,) of a polyline (N, 3)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
