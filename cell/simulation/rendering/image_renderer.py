"""Grey images of a scene, as a pinhole camera takes them.

Modelled: perspective, the area of a pixel, texture, a lamp with shadows, the dots of a projector, a calibration board,
vignetting, a slightly soft lens, noise and rounding of the sensor. Not modelled: gloss, residual distortion and motion
blur.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid
from cell.simulation.rendering.calibration_board import Print, SeenPrint
from cell.simulation.rendering.lighting import DotProjector, Lamp
from cell.simulation.rendering.materials import Materials
from cell.simulation.rendering.ray_caster import RayCaster

PAPER = 0.85
"""Reflectance of paper."""
INK = 0.06
"""Reflectance of ink."""
NOTHING = 0.05
"""Brightness without a surface."""
WHITE = 235.0
"""Grey level of a white surface in full light in the middle of the image, at the exposure 1."""
BLACK = 6.0
"""Grey level without light."""
VIGNETTE = 0.3
"""Relative loss of brightness in the corners of the image."""
BLUR_PX = 0.5
"""Blur of the lens, in addition to the area of a pixel."""
DARK_NOISE = 1.5
"""Noise without light, grey levels."""
SHOT_NOISE = 2.0
"""Noise from the light alone at level 255, grey levels."""

_SAMPLES = 2
"""Number of rays per pixel and axis."""
_BAND = 32
"""Number of pixel rows that are rendered in one step, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class PixelShift:
    """Displacement of an image by an imperfect rectification."""

    columns: NDArray[np.float32]
    """Displacement (H, W) to the right, pixels."""
    rows: NDArray[np.float32]
    """Displacement (H, W) downwards, pixels."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """What images show: a scene with its materials and its light."""

    caster: RayCaster
    materials: Materials
    lamp: Lamp
    board: Print | None = None
    """Print on the plate, which is the first object beside the strings, or None.

    The print is sampled finer than the rays, because corners are measured to a small part of a pixel.
    """
    strings: int = 0
    """Number of strings of the scene."""


class ImageRenderer:
    """A pinhole camera in front of a scene."""

    def __init__(
        self, scenery: Scenery, K: NDArray[np.float64], width: int, height: int, exposure: float = 1.0
    ) -> None:
        """Create the camera.

        Args:
            scenery: What the images show.
            K: Pinhole matrix (3, 3), pixels.
            width: Width of the images.
            height: Height of the images.
            exposure: Factor on the brightness.
        """
        self.scenery = scenery
        self.K = K
        self.width = width
        self.height = height
        self._exposure = exposure
        v, u = np.mgrid[:height, :width]
        middle_v = (height - 1) / 2
        middle_u = (width - 1) / 2
        off = ((v - middle_v) ** 2 + (u - middle_u) ** 2) / (middle_v**2 + middle_u**2)
        self._lens = (1 - VIGNETTE * off).astype(np.float32)

    def render(
        self,
        T_scene_camera: NDArray[np.float64],
        shift: PixelShift | None = None,
        dots: DotProjector | None = None,
        T_scene_projector: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """Return the image (H, W) in grey levels, without noise and rounding.

        Args:
            T_scene_camera: Camera pose (4, 4).
            shift: Displacement of the image, or None.
            dots: Dot projector, or None.
            T_scene_projector: Pose (4, 4) of the projector. It is needed with `dots`.
        """
        import cv2

        T = rigid(T_scene_camera, "T_scene_camera")
        shape = (self.height, self.width)
        image = np.empty(shape, dtype=np.float32)
        light = np.empty(shape, dtype=np.float32)
        on_plate = np.empty(shape, dtype=np.bool_)
        for top in range(0, self.height, _BAND):
            rows = slice(top, min(top + _BAND, self.height))
            image[rows], light[rows], on_plate[rows] = self._band(rows, T, shift, dots, T_scene_projector)
        if self.scenery.board is not None and on_plate.any():
            seen = self.scenery.board.seen(T, self.K, on_plate)
            white = _shifted(seen.white, seen, shift)
            black = _shifted(seen.black, seen, shift)
            printed = (PAPER * white + INK * black) * light[seen.rows, seen.columns]
            image[seen.rows, seen.columns] = printed + (1 - white - black) * image[seen.rows, seen.columns]
        blurred = cv2.GaussianBlur(image * self._lens, (5, 5), BLUR_PX)
        return np.asarray(BLACK + (WHITE - BLACK) * self._exposure * blurred, dtype=np.float32)

    def _band(
        self,
        rows: slice,
        T: NDArray[np.float64],
        shift: PixelShift | None,
        dots: DotProjector | None,
        T_scene_projector: NDArray[np.float64] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Return what a band (h, W) of pixel rows receives, the light on its surfaces, and where the plate is.

        The received light is without the print on the plate and without vignetting. The plate is that of the board.
        """
        import cv2

        size = (self.width, rows.stop - rows.start)
        scenery = self.scenery
        hits = scenery.caster.cast(T[:3, 3], self._directions(rows, T, shift))
        light = scenery.lamp.light(hits, scenery.caster)
        if dots is not None and T_scene_projector is not None:
            light += dots.light(hits, scenery.caster, T_scene_projector)
        grid = (_SAMPLES * size[1], _SAMPLES * size[0])
        seen = np.where(hits.is_hit, scenery.materials.reflectance(hits) * light, np.float32(NOTHING))
        on_plate = hits.part == scenery.strings + 1
        return (
            np.asarray(cv2.resize(seen.reshape(grid), size, interpolation=cv2.INTER_AREA), dtype=np.float32),
            np.asarray(cv2.resize(light.reshape(grid), size, interpolation=cv2.INTER_AREA), dtype=np.float32),
            on_plate.reshape(grid)[::_SAMPLES, ::_SAMPLES],
        )

    def _directions(self, rows: slice, T: NDArray[np.float64], shift: PixelShift | None) -> NDArray[np.float32]:
        """Return the directions (N, 3) of the rays through a band of pixel rows, scene frame."""
        u = (np.arange(_SAMPLES * self.width, dtype=np.float32) + 0.5) / _SAMPLES - 0.5
        v = (np.arange(_SAMPLES * rows.start, _SAMPLES * rows.stop, dtype=np.float32) + 0.5) / _SAMPLES - 0.5
        columns, lines = np.meshgrid(u, v)
        if shift is not None:
            columns -= np.kron(shift.columns[rows], np.ones((_SAMPLES, _SAMPLES), dtype=np.float32))
            lines -= np.kron(shift.rows[rows], np.ones((_SAMPLES, _SAMPLES), dtype=np.float32))
        to_scene = (T[:3, :3] @ np.linalg.inv(self.K)).astype(np.float32)
        # A product of matrices would start threads of the linear algebra library, which wait for busy cores.
        directions = np.multiply(columns[..., None], to_scene[:, 0], dtype=np.float32)
        directions += lines[..., None] * to_scene[:, 1]
        directions += to_scene[:, 2]
        return directions.reshape(-1, 3)


def _shifted(share: NDArray[np.float32], seen: SeenPrint, shift: PixelShift | None) -> NDArray[np.float32]:
    """Return a share (h, w) of a print, displaced as the image is. The print is sampled without the displacement."""
    import cv2

    if shift is None:
        return share
    v, u = np.mgrid[: share.shape[0], : share.shape[1]].astype(np.float32)
    columns = u - shift.columns[seen.rows, seen.columns]
    rows = v - shift.rows[seen.rows, seen.columns]
    return np.asarray(cv2.remap(share, columns, rows, cv2.INTER_LINEAR), dtype=np.float32)


def develop(still: NDArray[np.float32], rng: np.random.Generator, noise_factor: float = 1.0) -> NDArray[np.uint8]:
    """Return one image (H, W) with the noise and the rounding of the sensor.

    Args:
        still: Image (H, W) without noise, grey levels.
        rng: Generator of the noise.
        noise_factor: Factor on the noise.
    """
    spread = np.float32(noise_factor) * np.sqrt(DARK_NOISE**2 + SHOT_NOISE**2 / 255 * np.maximum(still, 0))
    noisy = still + spread * rng.standard_normal(still.shape, dtype=np.float32)
    return np.rint(noisy.clip(0, 255)).astype(np.uint8)
