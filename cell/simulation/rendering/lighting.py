"""Light on the surfaces: a lamp above the table, and the dot projector of the camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.simulation.rendering.appearance import sample_image
from cell.simulation.rendering.ray_caster import Hits, RayCaster

LIGHT_STREAM = 7
"""Stream of a seed from which the lamp is drawn."""

AMBIENT = 0.4
"""Share of ambient light."""
SHADE = 0.25
"""Share of the lamp's light that reaches a shaded point, by reflection from the surroundings."""

DOTS = 70
"""Number of dots of the projector in each direction."""
FIELD_TAN = 0.9
"""Tangent of half the field of the projector."""
DOT_RAD = 0.0018
"""Standard deviation of a dot's light."""
DOT_LIGHT = 2.0
"""Light in the middle of a dot at full power at `DOT_RANGE_M`, relative to the lamp's."""
DOT_RANGE_M = 0.5
"""Distance from the projector at which a dot has the light `DOT_LIGHT`."""
_DOT_TEXELS = 16
"""Width of the square of the pattern that has one dot."""
_JITTER_TEXELS = 6.0
"""Largest distance of a dot from the middle of its square, along each axis."""
_NEAREST_M = 1e-3
"""Smallest distance from the projector, so that nothing is divided by zero."""


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp above the table."""

    position: NDArray[np.float64]
    """Position (3,), scene frame, metres."""

    def light(self, hits: Hits, caster: RayCaster) -> NDArray[np.float32]:
        """Return the light (N,) on each hit, which is 1 on the table in the middle of the scene.

        It falls with the cosine and the squared distance.
        """
        to_lamp = self.position.astype(np.float32) - hits.points
        square = np.einsum("ni,ni->n", to_lamp, to_lamp)
        cosine = np.maximum(np.einsum("ni,ni->n", hits.normals, to_lamp), 0) / np.sqrt(square)
        middle = float(np.linalg.norm(self.position))
        direct = cosine / square * np.float32(middle**3 / self.position[2])
        direct = np.where(caster.is_shaded(hits, self.position), np.float32(SHADE) * direct, direct)
        return np.float32(AMBIENT) + np.float32(1 - AMBIENT) * direct


def draw_lamp(rng: np.random.Generator) -> Lamp:
    """Draw a lamp at least a metre above the table and beside its middle."""
    bearing = rng.uniform(0, 2 * np.pi)
    aside_m = rng.uniform(0.3, 0.6)
    return Lamp(np.array([aside_m * np.cos(bearing), aside_m * np.sin(bearing), rng.uniform(1.0, 1.4)]))


class DotProjector:
    """Projector of infrared dots on the camera."""

    def __init__(self, power: float, rng: np.random.Generator) -> None:
        """Draw the pattern of one device.

        Args:
            power: Share of the maximum power, 0 to 1.
            rng: Generator of the pattern.
        """
        size = _DOT_TEXELS * DOTS
        shape = (DOTS, DOTS)
        position = (np.arange(DOTS) + 0.5)[:, None] * _DOT_TEXELS
        column = np.broadcast_to(position, shape) + rng.uniform(-_JITTER_TEXELS, _JITTER_TEXELS, shape)
        row = np.broadcast_to(position.T, shape) + rng.uniform(-_JITTER_TEXELS, _JITTER_TEXELS, shape)
        self._per_tan = size / (2 * FIELD_TAN)
        spread = DOT_RAD * self._per_tan
        pattern = np.zeros((size, size), dtype=np.float32)
        reach = int(np.ceil(4 * spread))
        for x, y in zip(column.ravel(), row.ravel(), strict=True):
            rows = np.arange(max(int(y) - reach, 0), min(int(y) + reach + 1, size))
            columns = np.arange(max(int(x) - reach, 0), min(int(x) + reach + 1, size))
            square = (rows[:, None] - y) ** 2 + (columns - x) ** 2
            pattern[np.ix_(rows, columns)] += np.exp(-square / (2 * spread**2))
        self._pattern = np.float32(power * DOT_LIGHT) * pattern

    def light(self, hits: Hits, caster: RayCaster, T_scene_projector: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the light (N,) of the dots on each hit, which falls with the squared distance.

        Args:
            hits: Surfaces.
            caster: Scene of the surfaces, for shadows.
            T_scene_projector: Pose (4, 4) of the projector, which looks along z.
        """
        points = transform_points(inverse(T_scene_projector), hits.points.astype(np.float64)).astype(np.float32)
        half = np.float32(len(self._pattern) / 2)
        scale = np.float32(self._per_tan) / np.maximum(points[:, 2], np.float32(_NEAREST_M))
        column = np.asarray(half + scale * points[:, 0], dtype=np.float32)
        row = np.asarray(half + scale * points[:, 1], dtype=np.float32)
        light = sample_image(self._pattern, column, row, wrap=False)
        to_projector = T_scene_projector[:3, 3].astype(np.float32) - hits.points
        square = np.einsum("ni,ni->n", to_projector, to_projector)
        cosine = np.maximum(np.einsum("ni,ni->n", hits.normals, to_projector), 0) / np.sqrt(square)
        seen = light * cosine * np.float32(DOT_RANGE_M**2) / square
        return np.where(caster.is_shaded(hits, T_scene_projector[:3, 3]), np.float32(0), seen)
