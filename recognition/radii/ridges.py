"""Radius of strings from the ridges of their bands, seen from above: half their height above the table."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from recognition.errors import RadiusUnknownError
from recognition.parameters import R_MAX, R_MIN

CELL_M = 0.001
"""Edge of the grid cells for widths and heights, seen from above, metres."""
MAX_CELLS = 4_000_000
"""Maximum number of grid cells: 2 m by 2 m."""
MAX_HEIGHT_M = 4 * R_MAX
"""Maximum height above the table, metres. Higher points belong neither to a string nor to a crossing."""
BIN_M = 0.0004
"""Width of the bins in the histogram of heights, metres."""
MAX_HEIGHT_WIDTH_RATIO = 2.0
"""Maximum ratio of height to width, and of width to height, at a ridge cell of a string."""
MIN_LENGTH_M = 0.02
"""Minimum extent of a connected piece of cells along x or y, metres. Smaller pieces are noise."""
MIN_RIDGE_CELLS = 20
"""Minimum number of ridge cells for a measurement of the radius."""


def estimate_rough_radius(clouds: Sequence[NDArray[np.float64]], table_z_m: float) -> float:
    """Estimate the string radius roughly, with an error of up to about a quarter.

    Seen from above, a string is a band. The ridge of the band consists of the cells farthest from both sides. On the
    ridge, the height above the table is 2 r, and the distance from either side is r. Cells with other proportions
    belong to other objects. The height is doubled at crossings, but most of a string lies on the table.

    Args:
        clouds: Points (N, 3) above the table of each view, metres, base frame.
        table_z_m: Height of the table, metres.

    Returns:
        The radius, metres. It is the median of half the height over all ridge cells of strings.

    Raises:
        RadiusUnknownError: No band has the proportions of a string.
    """
    points = np.vstack([np.empty((0, 3)), *clouds])
    points = points[points[:, 2] - table_z_m < MAX_HEIGHT_M]
    if len(points):
        points = points[points[:, 2] - table_z_m > _noise_height(points[:, 2] - table_z_m)]
    if len(points) == 0:
        raise RadiusUnknownError("no string in view, so no radius can be measured: give the radius")
    radii = measure_ridges(points, table_z_m)
    if len(radii) < MIN_RIDGE_CELLS:
        raise RadiusUnknownError(
            "nothing above the table is as high as it is wide, like a string, so no radius can be measured: "
            "give the radius"
        )
    return float(np.median(radii))


def measure_ridges(points: NDArray[np.float64], table_z_m: float) -> NDArray[np.float64]:
    """Return half the height of each ridge cell of a string, seen from above (see `estimate_rough_radius`).

    Args:
        points: (N, 3) points above the table, at least one, metres, base frame.
        table_z_m: Height of the table, metres.

    Returns:
        (K,) half the heights, metres. Each ridge cell is about `CELL_M` of the length of a string.

    Raises:
        RadiusUnknownError: The points spread too far.
    """
    n_points, height = _grid_heights(points, table_z_m)
    band, half_width = _bands(n_points > 0)
    ridge = band & (half_width >= ndimage.maximum_filter(half_width, 3)) & (half_width > CELL_M) & (height > 0)
    radius = height[ridge] / 2
    width = half_width[ridge]
    is_string = (radius < MAX_HEIGHT_WIDTH_RATIO * width) & (width < MAX_HEIGHT_WIDTH_RATIO * radius)
    return radius[is_string & (radius > R_MIN) & (radius < R_MAX)]


def _grid_heights(points: NDArray[np.float64], table_z_m: float) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the point counts (A, B) and the heights (A, B) above the table of the cells of a horizontal grid."""
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / CELL_M).astype(np.int64) + 2
    rows, columns = (int(size) for size in cells.max(axis=0) + 3)
    if rows * columns > MAX_CELLS:
        raise RadiusUnknownError(
            f"the points above the table spread over {rows} by {columns} mm, which is too far to measure a radius: "
            "give the radius or a smaller workspace"
        )
    index = cells[:, 0] * columns + cells[:, 1]
    n_points = np.bincount(index, minlength=rows * columns)
    order = np.lexsort((points[:, 2], index))
    # The third highest point of a cell is robust: higher than most noise, and lower than flying pixels.
    last = np.cumsum(n_points) - 1
    third = order[np.maximum(last - np.minimum(2, np.maximum(n_points - 1, 0)), 0)]
    height = np.where(n_points > 0, points[third, 2] - table_z_m, 0.0)
    return n_points.reshape(rows, columns), height.reshape(rows, columns)


def _bands(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return the mask (A, B) of pieces of `MIN_LENGTH_M` or more, and the distances (A, B) from the sides, metres."""
    band = ndimage.binary_closing(occupied, iterations=2)
    half_width = np.asarray(ndimage.distance_transform_edt(band)) * CELL_M
    piece = np.zeros(occupied.shape, dtype=np.int32)
    ndimage.label(band, output=piece)
    extent = [
        max(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in ndimage.find_objects(piece)
    ]
    band &= np.concatenate([[False], np.array(extent) * CELL_M >= MIN_LENGTH_M])[piece]
    return band, half_width


def _noise_height(heights: NDArray[np.float64]) -> float:
    """Return the upper limit of the table noise, at which the histogram of `heights` (N,) stops falling, metres."""
    counts, edges = np.histogram(heights, np.arange(float(heights.min()), MAX_HEIGHT_M + 2 * BIN_M, BIN_M))
    smooth = np.convolve(counts, np.ones(3), "valid")
    rising = np.flatnonzero(np.diff(smooth) >= 0)
    return float(edges[rising[0] + 1]) if len(rising) and rising[0] > 0 else -np.inf
