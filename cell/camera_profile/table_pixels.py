"""Find the table in a depth image: the largest plane, the pixels on it, and the edges of objects.

The table is found in the image alone, without a calibration. The inverse depth of a plane is linear in column and row
with any pinhole matrix.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

STEP_M = 0.004
"""Smallest distance from the table of a pixel of an object. It is larger where the noise is."""
STEP_SIGMA = 3.0
"""Smallest distance from the table of a pixel of an object, as a multiple of the noise."""
EDGE_PX = 4
"""Largest distance of an edge pixel from an edge, along rows and columns."""
MIN_TABLE_SHARE = 0.2
"""Smallest share of the image that the table must fill."""

TRIALS, SAMPLES, SEED = 300, 3000, 0
"""Number of random planes, number of pixels at which they are compared, and the random seed."""
NEAR_PLANE_M = 0.01
"""Largest distance from a random plane of the pixels that support it."""
FITS = 2
"""Number of fits of the plane. After each, objects are searched again: they would pull the plane towards them."""


@dataclass(frozen=True, eq=False)
class TablePixels:
    """Table in a depth image."""

    plane_m: NDArray[np.float64]
    """Depth (H, W) of the plane, metres, infinite where its rays do not meet it."""
    table: NDArray[np.bool_]
    """Measured pixels (H, W) of the table away from objects."""
    edges: NDArray[np.bool_]
    """Pixels (H, W) near the edges of objects, measured or not."""
    inside_objects: NDArray[np.bool_]
    """Pixels (H, W) of objects and near them."""


def find_table(depth_m: NDArray[np.floating[Any]], edge_px: int = EDGE_PX) -> TablePixels | None:
    """Return the table in a depth image, or None if no plane fills enough of it.

    Args:
        depth_m: Depth (H, W), metres; 0 = not measured.
        edge_px: Largest distance of an edge pixel from an edge, along rows and columns.
    """
    plane_m = _largest_plane(depth_m)
    if plane_m is None:
        return None
    found = _classify(depth_m, plane_m, edge_px)
    for _ in range(FITS):
        if found.table.sum() < MIN_TABLE_SHARE * depth_m.size:
            return None
        found = _classify(depth_m, _fit_plane(depth_m, found.table), edge_px)
    return found


def image_positions(rows: NDArray[Any], columns: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return (N, 3) factors of a plane's inverse depth, which is linear in column and row with any pinhole matrix."""
    height, width = shape
    return np.column_stack([columns / width - 0.5, rows / height - 0.5, np.ones(len(rows))])


def _classify(depth_m: NDArray[np.floating[Any]], plane_m: NDArray[np.float64], edge_px: int) -> TablePixels:
    """Return the pixels of the table away from objects, and the pixels near the edges of objects."""
    measured = depth_m > 0
    distance = np.where(measured, depth_m - plane_m, 0.0)
    close = measured & (np.abs(distance) < NEAR_PLANE_M)
    sigma = 1.4826 * float(np.median(np.abs(distance[close]))) if close.any() else 0.0
    beyond = np.abs(distance) > max(STEP_M, STEP_SIGMA * sigma)
    objects = _dilated(_eroded(beyond, 1), 1)
    grown = _dilated(objects, edge_px)
    inner = _eroded(objects, edge_px)
    return TablePixels(plane_m, measured & ~beyond & ~grown, grown & ~inner, grown)


def _dilated(mask: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    """Return the pixels within a distance of a mask (H, W), along rows and columns."""
    import cv2

    square = np.ones((2 * reach_px + 1, 2 * reach_px + 1), dtype=np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), square), dtype=np.bool_)


def _eroded(mask: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    """Return the pixels whose neighbours within a distance are all in a mask (H, W) and in the image."""
    return ~_dilated(np.pad(~mask, reach_px, constant_values=True), reach_px)[reach_px:-reach_px, reach_px:-reach_px]


def _largest_plane(depth_m: NDArray[np.floating[Any]]) -> NDArray[np.float64] | None:
    """Return the depth (H, W) of the best of `TRIALS` random planes through three pixels, or None without one."""
    rows, columns = np.nonzero(depth_m)
    if len(rows) < MIN_TABLE_SHARE * depth_m.size:
        return None
    A, z = image_positions(rows, columns, depth_m.shape), depth_m[rows, columns]
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
    A = image_positions(rows, columns, depth_m.shape)
    plane = np.linalg.lstsq(A.T @ A, A.T @ (1 / depth_m[on_plane]), rcond=None)[0]
    return _plane_depth(plane, depth_m.shape)


def _plane_depth(plane: NDArray[np.floating[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the depth (H, W) of a plane, infinite where its rays do not meet it."""
    rows, columns = np.indices(shape).reshape(2, -1)
    inverse = (image_positions(rows, columns, shape) @ plane).reshape(shape)
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1.0), np.inf)
