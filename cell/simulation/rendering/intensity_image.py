"""Intensity image of the simulated cameras without rendered image pairs, in grey levels.

Modelled: perspective, averaging over the area of a pixel on a calibration board, a lamp that lights the table unevenly,
shading by the angle to the lamp, vignetting and a slightly soft lens, noise and rounding of the sensor. Not modelled:
shadows, gloss, residual distortion, motion blur, and the dots of a projector.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.depth_camera import DepthCamera, Surfaces
from cell.simulation.rendering.image_renderer import BLACK, BLUR_PX, INK, NOTHING, PAPER, VIGNETTE, WHITE
from cell.simulation.rendering.lighting import AMBIENT, draw_lamp
from cell.simulation.rendering.materials import CLUTTER
from cell.simulation.rendering.meshes import TABLE_HALF_M

STRING = 0.12
"""Reflectance of strings."""
TABLE = 0.42
"""Mean reflectance of the table."""
_TEXEL_M = 0.002
"""Size of a texel of the table's texture."""


@dataclass(frozen=True, eq=False)
class Lighting:
    """A lamp above the table, and the texture of the table."""

    lamp_m: NDArray[np.float64]
    """Position of the lamp (3,), scene frame."""
    table: NDArray[np.float32]
    """Reflectance (N, N) of the square table, from corner to corner."""


def lighting(rng: np.random.Generator) -> Lighting:
    """Return a lamp at least a metre above the table and beside it, and a textured table."""
    from scipy.ndimage import gaussian_filter

    lamp = draw_lamp(rng)
    texels = round(2 * TABLE_HALF_M / _TEXEL_M)
    white = rng.standard_normal((texels, texels), dtype=np.float32)
    spots = sum(size * gaussian_filter(white, size, mode="wrap") for size in (1.5, 4.0, 12.0))
    return Lighting(lamp.position, (TABLE * (1 + 0.12 * spots / np.std(spots))).clip(0.1, 0.7).astype(np.float32))


class PictureCamera:
    """The camera of the depth images, for intensity images."""

    def __init__(self, camera: DepthCamera, light: Lighting, board: Print | None = None) -> None:
        """Create the camera. `board` is printed on the first object beside the strings."""
        self._camera, self._light, self._board = camera, light, board
        width, height = camera.model.width, camera.model.height
        v, u = np.mgrid[:height, :width]
        middle = (height - 1) / 2, (width - 1) / 2
        off = ((v - middle[0]) ** 2 + (u - middle[1]) ** 2) / (middle[0] ** 2 + middle[1] ** 2)
        self._lens = (1 - VIGNETTE * off).astype(np.float32)

    def still(self, T_scene_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return what all images from this pose share, as grey levels (H, W) without noise and rounding."""
        import cv2

        surfaces = self._camera.surfaces(T_scene_camera)
        grey = self._thrown_back(surfaces)
        on_plate = surfaces.part == self._camera.strings + 1
        if self._board is not None and on_plate.any():
            seen = self._board.seen(T_scene_camera, self._camera.model.K, on_plate)
            around = grey[seen.rows, seen.columns]
            grey[seen.rows, seen.columns] = (
                PAPER * seen.white + INK * seen.black + (1 - seen.white - seen.black) * around
            )
        grey *= self._lit(surfaces, T_scene_camera)
        grey[surfaces.part < 0] = NOTHING
        blurred = cv2.GaussianBlur(grey * self._lens, (5, 5), BLUR_PX)
        return np.asarray(BLACK + (WHITE - BLACK) * blurred, dtype=np.float32)

    def _thrown_back(self, surfaces: Surfaces) -> NDArray[np.float32]:
        """Return the reflectance (H, W) of each pixel's surface, without a print."""
        import cv2

        strings = self._camera.strings
        share = np.where(surfaces.part < strings, np.float32(STRING), np.float32(CLUTTER))
        texel = (surfaces.points[..., :2] + TABLE_HALF_M) / _TEXEL_M - 0.5
        x, y = cv2.split(texel)
        on_table = cv2.remap(self._light.table, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.where(surfaces.part == strings, on_table, share)

    def _lit(self, surfaces: Surfaces, T_scene_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the light (H, W) on each pixel's surface, which is 1 on the table in the middle of the scene."""
        points, normals = surfaces.points, surfaces.normals
        lamp, eye = self._light.lamp_m.astype(np.float32), T_scene_camera[:3, 3].astype(np.float32)
        # the normal of a mesh may be on either side, so it is turned to the camera
        off = np.einsum("hwi,hwi->hw", normals, points)
        towards = (normals @ lamp - off) * np.sign(normals @ eye - off)
        to_lamp = points - lamp
        square = np.einsum("hwi,hwi->hw", to_lamp, to_lamp)
        # by the cosine and the squared distance, relative to the middle of the table
        direct = np.maximum(towards, 0) / (square * np.sqrt(square)) * np.float32(np.linalg.norm(lamp) ** 3 / lamp[2])
        return np.float32(AMBIENT) + np.float32(1 - AMBIENT) * direct
