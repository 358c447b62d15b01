"""Filter of flying pixels, whose measured depth lies between foreground and background at a depth discontinuity."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

MIN_NEIGHBOURS = 5
"""Minimum number of the eight neighbours that lie on the same surface as the pixel.

A pixel at a straight edge has five such neighbours. A pixel with fewer neighbours is a spike of the edge or a flying
pixel. On simulated scans, the filter halves the mean outward bias of the surface and removes a tenth of the points.
"""
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
"""Offsets (rows, columns) of the eight neighbours, around the pixel."""
MIN_SPECKLED_SHARE = 0.1
"""Minimum number of pixels with scattered losses around them, relative to the pixels with enough neighbours. With
fewer, losses are rare in the image, and an unmeasured neighbour is probably the shadow of an edge.

If 30 % of the pixels are lost, a fifth of the inner pixels has too few neighbours.
"""
THIN_PX = 4.0
"""Width of a string in the image, pixels, below which `MIN_NEIGHBOURS_THIN` is used."""
MIN_NEIGHBOURS_THIN = 2
"""Minimum number of neighbours for a thin string: the pixels before and after along the string."""


def _pixels_behind(down: int, right: int) -> tuple[tuple[int, int], ...]:
    """Return the offsets of the three pixels behind a neighbour, seen from the pixel."""
    behind = (2 * down, 2 * right)
    if down and right:
        return behind, (down, 2 * right), (2 * down, right)
    return behind, (2 * down + right, 2 * right + down), (2 * down - right, 2 * right - down)


BEHIND_NEIGHBOURS = tuple(_pixels_behind(down, right) for down, right in NEIGHBOURS)
"""Offsets of the three pixels behind each neighbour."""


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

    A neighbour that is not measured counts as well if it is a scattered loss inside the surface and such losses are
    frequent, as on dark or glossy strings. At the edge of a shadow, the pixels on one side are not measured, and they
    do not count.

    Args:
        image: Depth image.
        rows: (N,) rows of measured pixels.
        columns: (N,) columns of measured pixels.
        parameters: Method parameters; uses the radius r. Neighbours with a depth difference below r / 2 lie on the same
            surface.

    Returns:
        Mask (N,), True for pixels on a surface.
    """
    depth = image.depth[rows, columns].astype(np.int32)
    max_step = parameters.r / 2 / image.depth_unit_m
    around = _depths_at(image.depth, rows, columns, NEIGHBOURS)
    is_same = (around > 0) & (np.abs(around - depth) < max_step)
    n_neighbours = is_same.sum(axis=0)
    string_width_px = 2 * parameters.r * image.K[0, 0] / (np.maximum(depth, 1) * image.depth_unit_m)
    min_neighbours = np.where(string_width_px < THIN_PX, MIN_NEIGHBOURS_THIN, MIN_NEIGHBOURS)
    is_kept = n_neighbours >= min_neighbours
    is_uniform = (is_same | (around <= 0)).all(axis=0)
    n_lost = (around == 0).sum(axis=0)
    candidates = np.flatnonzero(~is_kept & is_uniform & (n_neighbours + n_lost >= min_neighbours))
    n_needed = min_neighbours[candidates] - n_neighbours[candidates]
    behind = np.array(
        [_depths_at(image.depth, rows[candidates], columns[candidates], offsets) for offsets in BEHIND_NEIGHBOURS]
    )
    is_same_behind = (behind > 0) & (np.abs(behind - depth[candidates]) < max_step)
    is_speckled = _is_speckled(is_same[:, candidates], behind, is_same_behind, n_needed)
    if is_speckled.sum() > MIN_SPECKLED_SHARE * is_kept.sum():
        is_kept[candidates] = is_speckled
    return is_kept


def _is_speckled(
    is_same: NDArray[np.bool_],
    behind: NDArray[np.int32],
    is_same_behind: NDArray[np.bool_],
    n_needed: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Return which pixels (N,) lie inside a surface from which scattered pixels are lost.

    Behind at least `n_needed` (N,) lost neighbours, the surface goes on. All pixels measured there lie on it, and they
    are on all sides: at the edge of a shadow, three neighbours in a row have none.

    Args:
        is_same: (8, N) mask of the neighbours on the same surface.
        behind: (8, 3, N) depth counts of the pixels behind each neighbour; -1 outside the image.
        is_same_behind: (8, 3, N) mask of these pixels that are on the same surface.
        n_needed: (N,) minimum number of lost neighbours.
    """
    goes_on = is_same_behind.any(axis=1)
    is_empty = ~(is_same | goes_on)
    is_one_sided = (is_empty & np.roll(is_empty, 1, axis=0) & np.roll(is_empty, 2, axis=0)).any(axis=0)
    is_uniform = (is_same_behind | (behind <= 0)).all(axis=(0, 1))
    return is_uniform & ~is_one_sided & ((goes_on & ~is_same).sum(axis=0) >= n_needed)


def _depths_at(
    image: NDArray[np.uint16], rows: NDArray[np.intp], columns: NDArray[np.intp], offsets: Sequence[tuple[int, int]]
) -> NDArray[np.int32]:
    """Return the depth counts (K, N) at K offsets from each pixel; -1 outside the image."""
    height, width = image.shape
    depths = np.empty((len(offsets), len(rows)), dtype=np.int32)
    for k, (down, right) in enumerate(offsets):
        v = rows + down
        u = columns + right
        is_in_image = (v >= 0) & (v < height) & (u >= 0) & (u < width)
        depths[k] = np.where(is_in_image, image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], -1)
    return depths
