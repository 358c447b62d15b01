"""Filter of flying pixels, whose measured depth lies between foreground and background at a depth discontinuity."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

MIN_NEIGHBOURS = 5
"""Minimum number of the eight neighbours that lie on the same surface as the pixel.

A pixel at a straight edge has five such neighbours. A pixel with fewer neighbours is a spike of the edge or a flying
pixel. On simulated scans, the filter halves the mean outward bias of the surface and removes a tenth of the points.
"""
THIN_PX = 4.0
"""Width of a string in the image, pixels, below which `MIN_NEIGHBOURS_THIN` is used."""
MIN_NEIGHBOURS_THIN = 2
"""Minimum number of neighbours for a thin string: the pixels before and after along the string."""


class DepthImage(Protocol):
    """Protocol of a depth image: any object with these three attributes."""

    @property
    def depth(self) -> NDArray[np.uint16]:
        """(H, W) depth along the optical axis in units of `depth_unit_m`; 0 = not measured."""
        ...

    @property
    def depth_unit_m(self) -> float:
        """Metres per depth count."""
        ...

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) pinhole matrix, pixels."""
        ...


def is_on_surface(
    image: DepthImage, rows: NDArray[np.intp], columns: NDArray[np.intp], parameters: ChainParameters
) -> NDArray[np.bool_]:
    """Return which pixels have enough neighbours on the same surface. All other pixels are flying pixels.

    Args:
        image: Depth image.
        rows: (N,) rows of measured pixels.
        columns: (N,) columns of measured pixels.
        parameters: Method parameters; uses the radius r. Neighbours with a depth difference below r / 2 lie on the same
            surface.

    Returns:
        Mask (N,), True for pixels on a surface.
    """
    height, width = image.depth.shape
    depth = image.depth[rows, columns].astype(np.int32)
    max_step = parameters.r / 2 / image.depth_unit_m
    n_neighbours = np.zeros(len(rows), dtype=np.int64)
    for down, right in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        v, u = rows + down, columns + right
        is_in_image = (v >= 0) & (v < height) & (u >= 0) & (u < width)
        neighbour = image.depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(np.int32)
        n_neighbours += is_in_image & (neighbour > 0) & (np.abs(neighbour - depth) < max_step)
    string_width_px = 2 * parameters.r * image.K[0, 0] / (np.maximum(depth, 1) * image.depth_unit_m)
    return n_neighbours >= np.where(string_width_px < THIN_PX, MIN_NEIGHBOURS_THIN, MIN_NEIGHBOURS)
