"""A first idea of the string's radius, when nobody tells it: half the height of what is long and thin on the table."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recognition.errors import RecognitionError
from recognition.parameters import R_MAX, R_MIN

CELL_M = 0.001
"""Grid, seen from above, on which widths and heights are taken."""
MAX_CELLS = 4_000_000
"""Grid cells taken: two metres by two."""
HIGHEST_M = 4 * R_MAX
"""What is higher above the table is no string, nor two on one another."""
BIN_M = 0.0004
"""Bins in which heights are counted."""
ALIKE = 2.0
"""A ridge is a string's where half its height and half its width differ by no more than this factor."""
MIN_LENGTH_M = 0.02
"""Shorter pieces are specks of noise."""
MIN_RIDGE = 20
"""Fewer ridge cells than this are no string."""


class RadiusUnknownError(RecognitionError):
    """Nothing above the table allows the radius of a string to be measured. Give the radius."""

    slug = "radius-unknown"


def estimate_rough_radius(clouds: Sequence[NDArray[np.float64]], table_z_m: float) -> float:
    """The radius, metres, of the strings in the views' points above the table ((N, 3) each), to about a quarter.

    Seen from above, a string is a band; along its middle, as far as possible from its sides, its height above the
    table is 2 r and the way to either side is r. Places at which the two disagree are other things; at a crossing
    the height is double, but most of a string lies on the table.

    Raises:
        RadiusUnknownError: there is no such band.
    """
    points = np.vstack([np.empty((0, 3)), *clouds])
    points = points[points[:, 2] - table_z_m < HIGHEST_M]
    if len(points):
        points = points[points[:, 2] - table_z_m > _noise_height(points[:, 2] - table_z_m)]
    if len(points) == 0:
        raise RadiusUnknownError("no string in view to measure the radius of: give the radius")
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / CELL_M).astype(np.int64) + 2
    rows, columns = (int(size) for size in cells.max(axis=0) + 3)
    if rows * columns > MAX_CELLS:
        raise RadiusUnknownError(
            f"the points above the table spread over {rows} by {columns} mm, too far to find a string's radius "
            "in: give the radius or a smaller workspace"
        )
    index = cells[:, 0] * columns + cells[:, 1]
    count = np.bincount(index, minlength=rows * columns)
    order = np.lexsort((points[:, 2], index))
    # The third highest of a cell's points: above most noise, below flying pixels.
    last = np.cumsum(count) - 1
    third = order[np.maximum(last - np.minimum(2, np.maximum(count - 1, 0)), 0)]
    height = np.where(count > 0, points[third, 2] - table_z_m, 0.0).reshape(rows, columns)
    band = ndimage.binary_closing(count.reshape(rows, columns) > 0, iterations=2)
    half_width = np.asarray(ndimage.distance_transform_edt(band)) * CELL_M
    piece = np.zeros((rows, columns), dtype=np.int32)
    ndimage.label(band, output=piece)
    extent = [max(part.stop - part.start for part in where) for where in ndimage.find_objects(piece) if where]
    band &= np.concatenate([[False], np.array(extent) * CELL_M >= MIN_LENGTH_M])[piece]
    ridge = band & (half_width >= ndimage.maximum_filter(half_width, 3)) & (half_width > CELL_M) & (height > 0)
    radius, width = height[ridge] / 2, half_width[ridge]
    alike = (radius < ALIKE * width) & (width < ALIKE * radius) & (radius > R_MIN) & (radius < R_MAX)
    if alike.sum() < MIN_RIDGE:
        raise RadiusUnknownError(
            "nothing above the table is as high as it is wide, like a string, so its radius cannot be measured: "
            "give the radius"
        )
    return float(np.median(radius[alike]))


def _noise_height(heights: NDArray[np.float64]) -> float:
    """Up to which of the `heights` (N,) they are the table's noise: as long as there are ever fewer of them."""
    counts, edges = np.histogram(heights, np.arange(float(heights.min()), HIGHEST_M + 2 * BIN_M, BIN_M))
    smooth = np.convolve(counts, np.ones(3), "valid")
    rising = np.flatnonzero(np.diff(smooth) >= 0)
    return float(edges[rising[0] + 1]) if len(rising) and rising[0] > 0 else -np.inf
