"""Noise of single exposures of a table at rest, and what the median of several exposures leaves of it.

The table is the largest plane in view. It is found in the images, without a calibration.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.camera.frame_averaging import median

COUNTS = (1, 3, 5)
"""Numbers of exposures that are compared."""
NOISE_MARGIN = 0.05
"""Largest excess of the noise on the table over that of the largest number of exposures, relative to that."""
FLICKER_MARGIN = 0.01
"""Largest excess of the flicker over that of the largest number of exposures, as a share of the edge pixels."""

STEP_M = 0.004
"""Smallest distance from the table of a pixel of an object. It is larger where the noise is."""
STEP_SIGMA = 3.0
"""Smallest distance from the table of a pixel of an object, as a multiple of the noise."""
JUMP_M = 0.005
"""Smallest change of the depth at an edge that counts as flicker."""
EDGE_PX = 4
"""Largest distance of an edge pixel from an edge, along rows and columns."""
MIN_EDGE_PIXELS = 500
"""Smallest number of edge pixels for a statement about flicker. A hundredth of them is then five pixels."""
MIN_TABLE_SHARE = 0.2
"""Smallest share of the image that the table must fill."""

TRIALS, SAMPLES, SEED = 300, 3000, 0
"""Number of random planes, number of pixels at which they are compared, and the random seed."""
NEAR_PLANE_M = 0.01
"""Largest distance from a random plane of the pixels that support it."""
FITS = 2
"""Number of fits of the plane. After each, objects are searched again: they would pull the plane towards them."""


@dataclass(frozen=True)
class MedianNoise:
    """Noise of views that are the median of a number of exposures."""

    exposures: int
    """Number of exposures of a view."""
    temporal_m: float
    """Standard deviation of a pixel's depth over the views, root mean square over the table, along the optical axis."""
    total_m: float
    """Root mean square of the fixed and the temporal noise together."""
    flicker_share: float | None
    """Share of the edge pixels that jump, appear or disappear from one view to the next. None: too few edges."""


@dataclass(frozen=True)
class ExposureNoise:
    """Noise of a camera at rest in front of a table."""

    fixed_m: float
    """Distance between table and plane that all exposures share, root mean square, along the optical axis."""
    table_pixels: int
    """Number of pixels of the table that every exposure measured, away from edges."""
    edge_pixels: int
    """Number of pixels near edges that at least one exposure measured."""
    medians: tuple[MedianNoise, ...]
    """Noise by number of exposures, in the order of `COUNTS`."""


def measure_noise(depth: NDArray[np.uint16], depth_unit_m: float) -> ExposureNoise | None:
    """Return the noise of exposures of a scene at rest, or None if no plane fills enough of the image.

    Args:
        depth: Depth images (N, H, W), at least 10, in depth units; 0 = not measured.
        depth_unit_m: Metres per depth count.
    """
    middle = median(list(depth)) * depth_unit_m
    plane = _largest_plane(middle)
    if plane is None:
        return None
    table, edges = _table_and_edges(middle, plane)
    for _ in range(FITS):
        if table.sum() < MIN_TABLE_SHARE * middle.size:
            return None
        plane = _fit_plane(middle, table)
        table, edges = _table_and_edges(middle, plane)
    flat, edges = table & depth.all(axis=0), edges & depth.any(axis=0)
    if flat.sum() < MIN_TABLE_SHARE * middle.size:
        return None
    on_table, at_edges = depth[:, flat], depth[:, edges]
    single_m2 = float(np.mean(np.var(on_table * depth_unit_m, axis=0, ddof=1)))
    residual_m = on_table.mean(axis=0) * depth_unit_m - plane[flat]
    # the mean of N exposures still has their noise, divided by N
    fixed_m2 = float(np.mean(residual_m**2)) - single_m2 / len(depth)
    fixed_m = float(np.sqrt(max(fixed_m2, 0.0)))
    enough = int(edges.sum()) >= MIN_EDGE_PIXELS
    medians = []
    for count in COUNTS:
        temporal_m = _temporal_noise(_views(on_table, count) * depth_unit_m)
        flicker_share = _flicker(_views(at_edges, count) * depth_unit_m) if enough else None
        medians.append(MedianNoise(count, temporal_m, float(np.hypot(fixed_m, temporal_m)), flicker_share))
    return ExposureNoise(fixed_m, int(flat.sum()), int(edges.sum()), tuple(medians))


def recommended_exposures(noise: ExposureNoise) -> int | None:
    """Return the smallest number of exposures that is as good as the largest, or None if the flicker is unknown.

    Compared with the largest number, its noise on the table is at most 5 % larger (`NOISE_MARGIN`), and its flicker
    affects at most one more in a hundred edge pixels (`FLICKER_MARGIN`).
    """
    last = noise.medians[-1]
    for candidate in noise.medians:
        if candidate.flicker_share is None or last.flicker_share is None:
            return None
        quiet = candidate.total_m <= (1 + NOISE_MARGIN) * last.total_m
        if quiet and candidate.flicker_share <= last.flicker_share + FLICKER_MARGIN:
            return candidate.exposures
    return last.exposures


def _views(depth: NDArray[np.uint16], count: int) -> NDArray[np.uint16]:
    """Return the median of each group of `count` exposures in a row (N // count, M), of exposures (N, M)."""
    firsts = range(0, len(depth) - count + 1, count)
    return np.stack([median(list(depth[first : first + count])) for first in firsts])


def _temporal_noise(views_m: NDArray[np.floating[Any]]) -> float:
    """Return the root mean square over all pixels of the standard deviation over the views (V, M)."""
    return float(np.sqrt(np.mean(np.var(views_m, axis=0, ddof=1))))


def _flicker(views_m: NDArray[np.floating[Any]]) -> float:
    """Return the share of the pixels (V, M) that differ between one view and the next, the mean of all pairs."""
    before, after = views_m[:-1], views_m[1:]
    lost = (before > 0) != (after > 0)
    jumped = (before > 0) & (after > 0) & (np.abs(after - before) > JUMP_M)
    return float(np.mean(lost | jumped))


def _table_and_edges(
    depth_m: NDArray[np.floating[Any]], plane_m: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the measured pixels (H, W) of the table away from objects, and all pixels near the edges of objects."""
    from scipy.ndimage import binary_dilation, binary_erosion, binary_opening

    measured = depth_m > 0
    distance = np.where(measured, depth_m - plane_m, 0.0)
    close = measured & (np.abs(distance) < NEAR_PLANE_M)
    sigma = 1.4826 * float(np.median(np.abs(distance[close]))) if close.any() else 0.0
    beyond = np.abs(distance) > max(STEP_M, STEP_SIGMA * sigma)
    objects = binary_opening(beyond, np.ones((3, 3), dtype=bool))
    square = np.ones((2 * EDGE_PX + 1, 2 * EDGE_PX + 1), dtype=bool)
    grown = np.asarray(binary_dilation(objects, square), dtype=np.bool_)
    inner = np.asarray(binary_erosion(objects, square), dtype=np.bool_)
    return measured & ~beyond & ~grown, grown & ~inner


def _largest_plane(depth_m: NDArray[np.floating[Any]]) -> NDArray[np.float64] | None:
    """Return the depth (H, W) of the best of `TRIALS` random planes through three pixels, or None without one."""
    rows, columns = np.nonzero(depth_m)
    if len(rows) < MIN_TABLE_SHARE * depth_m.size:
        return None
    A, z = _positions(rows, columns, depth_m.shape), depth_m[rows, columns]
    rng = np.random.default_rng(SEED)
    some = rng.integers(len(z), size=SAMPLES)
    corners = rng.integers(len(z), size=(TRIALS, 3))
    # three pixels on a line have no plane
    corners = corners[np.abs(np.linalg.det(A[corners])) > 1e-3]
    if not len(corners):
        return None
    planes = np.linalg.solve(A[corners], 1 / z[corners][..., None])[..., 0]
    # relative errors of depth and inverse depth are equal, for small ones
    support = np.abs(z[some] * (planes @ A[some].T) - 1) * z[some] < NEAR_PLANE_M
    return _plane_depth(planes[support.sum(axis=1).argmax()], depth_m.shape)


def _fit_plane(depth_m: NDArray[np.floating[Any]], on_plane: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the depth (H, W) of the plane through the marked pixels (H, W), by least squares of the inverse depth."""
    rows, columns = np.nonzero(on_plane)
    A = _positions(rows, columns, depth_m.shape)
    return _plane_depth(np.linalg.lstsq(A, 1 / depth_m[on_plane], rcond=None)[0], depth_m.shape)


def _plane_depth(plane: NDArray[np.floating[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the depth (H, W) of a plane, infinite where its rays do not meet it."""
    rows, columns = np.indices(shape).reshape(2, -1)
    inverse = (_positions(rows, columns, shape) @ plane).reshape(shape)
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)


def _positions(rows: NDArray[np.int64], columns: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return (N, 3) factors of a plane's inverse depth, which is linear in column and row with any pinhole matrix."""
    height, width = shape
    return np.column_stack([columns / width - 0.5, rows / height - 0.5, np.ones(len(rows))])
