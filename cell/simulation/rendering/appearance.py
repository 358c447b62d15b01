"""Appearance of the simulated surfaces: what the sheath of the strings and the table top look like to a stereo camera.

Stereo matching measures texture, so the appearance decides how well a string is measured. A texture is a random tile
that repeats.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.config.rendering_options import SHEATHS, TABLE_TOPS, RenderingOptions, Sheath, TableTop

TEXTURED_SHEATHS: tuple[Sheath, ...] = ("speckled", "painted", "woven")
"""Sheaths of which one is drawn."""
TEXTURED_TABLE_TOPS: tuple[TableTop, ...] = ("printed", "grained")
"""Table tops of which one is drawn."""

STRING_REFLECTANCE = 0.12, 0.70
"""Smallest and largest mean reflectance of a string."""
TABLE_REFLECTANCE = 0.30, 0.55
"""Smallest and largest mean reflectance of a table top."""

TILE = 1024
"""Width and height of the tile of a texture, texels."""
_TABLE_TEXEL_M = 0.0004
_SHEATH_TEXEL_M = 0.0002
_DARKEST = 0.02
"""Smallest reflectance of a textured surface."""

_SIZES: dict[str, tuple[float, ...]] = {
    "speckled": (2.0, 5.0, 12.0),
    "painted": (4.0, 14.0, 40.0),
    "woven": (2.0, 8.0),
    "smooth": (6.0, 30.0),
    "printed": (1.5, 4.0, 12.0),
    "grained": (2.0, 8.0, 30.0),
    "bare": (3.0, 20.0),
}
"""Standard deviations of the blurs whose sum is the texture, texels."""
_CONTRAST = {
    "speckled": 0.35,
    "painted": 0.30,
    "woven": 0.25,
    "smooth": 0.02,
    "printed": 0.30,
    "grained": 0.10,
    "bare": 0.015,
}
"""Standard deviation of the reflectance relative to its mean."""
_GRAIN_TEXELS = 1.0, 25.0
"""Standard deviations of the blur of wood across the grain and along it."""
_APPEARANCE_STREAM = 13
"""Stream of a seed from which the appearance is drawn."""
_FOLD = 1024
"""Width of the image to which the points of `sample_image` are folded."""
_YARN_TEXELS = 16
"""Width of a yarn of a woven sheath, a divisor of `TILE`."""


@dataclass(frozen=True)
class Appearance:
    """Materials of the strings and of the table."""

    sheath: Sheath
    """Surface of all strings."""
    table_top: TableTop
    """Surface of the table."""
    string_reflectance: float
    """Mean reflectance of the strings."""
    table_reflectance: float
    """Mean reflectance of the table."""


def draw_appearance(
    rng: np.random.Generator, sheaths: Sequence[Sheath] = SHEATHS, table_tops: Sequence[TableTop] = TABLE_TOPS
) -> Appearance:
    """Draw an appearance from the given materials."""
    return Appearance(
        sheath=sheaths[int(rng.integers(len(sheaths)))],
        table_top=table_tops[int(rng.integers(len(table_tops)))],
        string_reflectance=float(rng.uniform(*STRING_REFLECTANCE)),
        table_reflectance=float(rng.uniform(*TABLE_REFLECTANCE)),
    )


def appearance_of_seed(options: RenderingOptions, seed: int) -> Appearance:
    """Return the appearance of a simulated scene.

    Args:
        options: Configured materials. The others are drawn among those with texture.
        seed: Seed of the device. The reflectances do not depend on the configured materials.
    """
    rng = np.random.default_rng([seed, _APPEARANCE_STREAM])
    drawn = draw_appearance(rng, TEXTURED_SHEATHS, TEXTURED_TABLE_TOPS)
    return replace(drawn, sheath=options.sheath or drawn.sheath, table_top=options.table_top or drawn.table_top)


@dataclass(frozen=True, eq=False)
class Texture:
    """Reflectance of a surface, as a tile that repeats in both directions."""

    tile: NDArray[np.float32]
    """Reflectance (`TILE`, `TILE`)."""
    texel_m: float
    """Width of a texel."""

    def at(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the reflectance (N,) at the surface coordinates (N,), metres."""
        column_px = np.mod(x / np.float32(self.texel_m), np.float32(TILE))
        row_px = np.mod(y / np.float32(self.texel_m), np.float32(TILE))
        return sample_image(self.tile, column_px, row_px, wrap=True)


def sample_image(
    image: NDArray[np.float32], column_px: NDArray[np.float32], row_px: NDArray[np.float32], wrap: bool
) -> NDArray[np.float32]:
    """Return the interpolated values (N,) of an image at the positions (N,).

    Args:
        image: Image (H, W).
        column_px: Columns (N,); integers are the centres of pixels.
        row_px: Rows (N,).
        wrap: Whether the image repeats. Otherwise, the value outside is 0.
    """
    import cv2

    if len(column_px) == 0:
        return np.zeros(0, dtype=np.float32)
    # OpenCV maps images of at most 32,767 rows, so the points are folded to rows of an image
    rows = -(-len(column_px) // _FOLD)
    folded = np.zeros((2, rows * _FOLD), dtype=np.float32)
    folded[0, : len(column_px)] = column_px
    folded[1, : len(row_px)] = row_px
    columns, lines = folded.reshape(2, rows, _FOLD)
    border = cv2.BORDER_WRAP if wrap else cv2.BORDER_CONSTANT
    values = cv2.remap(image, columns, lines, cv2.INTER_LINEAR, borderMode=border)
    return np.asarray(values, dtype=np.float32).ravel()[: len(column_px)]


def table_texture(appearance: Appearance, rng: np.random.Generator) -> Texture:
    """Draw the texture of the table top."""
    return _texture(appearance.table_top, appearance.table_reflectance, _TABLE_TEXEL_M, rng)


def sheath_texture(appearance: Appearance, rng: np.random.Generator) -> Texture:
    """Draw the texture of the strings. Its coordinates are the arc length and the arc around the string."""
    return _texture(appearance.sheath, appearance.string_reflectance, _SHEATH_TEXEL_M, rng)


def _texture(material: str, mean: float, texel_m: float, rng: np.random.Generator) -> Texture:
    """Draw a texture as a sum of noise of several sizes, with yarns for a woven one."""
    from scipy.ndimage import gaussian_filter

    relief = np.zeros((TILE, TILE), dtype=np.float32)
    for size in _SIZES[material]:
        noise = gaussian_filter(rng.standard_normal((TILE, TILE), dtype=np.float32), size, mode="wrap")
        relief += noise / noise.std()
    if material == "woven":
        relief = relief / relief.std() + _yarns()
    if material == "grained":
        grain = gaussian_filter(relief, _GRAIN_TEXELS, mode="wrap")
        relief = grain / grain.std() + relief / relief.std()
    relief *= np.float32(_CONTRAST[material]) / relief.std()
    tile = (np.float32(mean) * (1 + relief)).clip(_DARKEST, 1.0)
    return Texture(tile.astype(np.float32), texel_m)


def _yarns() -> NDArray[np.float32]:
    """Return two sets of diagonal yarns (`TILE`, `TILE`) that pass over each other, about -1 to 1."""
    v, u = np.mgrid[:TILE, :TILE].astype(np.float32)
    wave = np.float32(np.pi / _YARN_TEXELS)
    yarns = np.sin(wave * (u + v)) * np.sin(wave * (u - v))
    return np.asarray(2 * yarns, dtype=np.float32)
