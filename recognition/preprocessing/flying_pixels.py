"""Filter of flying pixels: at a depth discontinuity, a camera measures depths between foreground and background."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

MIN_NEIGHBOURS = 5
"""Number of the eight neighbours that must lie on the surface of a pixel. A pixel at a straight edge has five; fewer
mean a spike of the edge or a flying pixel. On simulated scans this halves the mean outward bias of the surface and
removes a tenth of the points."""
THIN_PX = 4.0
"""A string that is narrower than this in the image does not have such neighbourhoods."""
MIN_NEIGHBOURS_THIN = 2
"""Number of neighbours for such a thin string: the pixels before and after."""


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
    """Return which pixels have enough neighbours on the same surface. The others are flying pixels.

    Args:
        image: Depth image.
        rows: (N,) rows of measured pixels.
        columns: (N,) columns of measured pixels.
        parameters: Radii and thresholds. Neighbours whose depth differs by less than r / 2 lie on the same surface.

    Returns:
        (N,) mask.

    Source:
        Ours.
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
