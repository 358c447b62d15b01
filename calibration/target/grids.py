"""Detect checkerboards and circle grids with OpenCV's detectors. The whole board must be in the image."""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_ordering import (
    is_larger_dot_misplaced,
    make_right_handed,
    order_from_black_square,
    order_from_larger_dot,
)
from calibration.target.corner_refinement import refine_corners

GridCorners = tuple[NDArray[np.int64], NDArray[np.float64], bool]
"""Numbers (N,) and pixels (N, 2) of the detected points, and whether the image determines the first point."""

THRESHOLDS = (10, 230, 10)
"""Grey levels at which dots are searched: first, last, step. Blobs of neighbouring levels are joined, so that shade or
glare on part of the board does not matter."""
MIN_DOT_PX = 5.0
"""Minimum diameter of a dot, pixels. Smaller ones cannot be distinguished from noise."""
MAX_DOT_SHARE = 0.2
"""Maximum diameter of a dot, as a share of the shorter image side."""
MIN_INERTIA_RATIO = 0.15
"""Minimum roundness of a dot, the ratio of its smallest to its largest moment. A circle tilted by 65 degrees has this
value."""
MIN_CONVEXITY = 0.9
"""Minimum convexity of a dot: its area divided by that of its convex hull."""
GRID_FINDER_PITCH_PX = 30.0
"""Distance of neighbouring dots for which OpenCV's grid finder is made, since its settings are lengths in pixels."""


class LargerDotMisplacedError(ValueError):
    """The larger dot is at a corner that cannot be the first: columns and rows swapped, or the image mirrored."""


def find_checkerboard(grey: NDArray[np.uint8], board: Board) -> GridCorners:
    """Return the inner corners of a checkerboard in a grey image (H, W); none unless the whole board is visible."""
    import cv2

    for flags in (cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, corners = cv2.findChessboardCornersSB(grey, board.shape, flags=flags)
        if found:
            break
    else:
        return _no_corners()
    grid = make_right_handed(_to_grid(corners, board))
    ordered, is_unique = order_from_black_square(grid, grey, board)
    return *refine_corners(grey, board, board.points[:, :2], ordered.reshape(-1, 2)), is_unique


def find_circles(grey: NDArray[np.uint8], board: Board) -> GridCorners:
    """Return the dots of a circle grid, dark on light, in a grey image; none unless the whole board is visible.

    Args:
        grey: (H, W) grey image.
        board: The board, of the kind `circles`.

    Returns:
        Numbers (N,), pixels (N, 2), and whether the larger dot determines the first dot.

    Raises:
        LargerDotMisplacedError: The larger dot is at a corner that cannot be the first.
    """
    from scipy.spatial import KDTree

    blobs, blob_diameters = _detect_blobs(grey)
    centres = _find_dot_grid(blobs, board)
    if centres is None:
        return _no_corners()
    grid = make_right_handed(_to_grid(centres, board))
    diameters = blob_diameters[KDTree(blobs).query(grid)[1]]
    ordered, diameters, is_unique = order_from_larger_dot(grid, diameters)
    if not is_unique and board.columns != board.rows and is_larger_dot_misplaced(diameters):
        raise LargerDotMisplacedError
    approximate = ordered.reshape(-1, 2)
    # The board does not define the dot size, and with perspective the size shifts the centre.
    ratios = diameters / np.sqrt(_cell_areas(ordered))
    common = round(float(np.median(ratios)), 2)
    first = round(float(ratios[0, 0]), 2) if is_unique else common
    corners = refine_corners(grey, board, board.points[:, :2], approximate, dot_diameters=(common, first))
    return *corners, is_unique


def _no_corners() -> GridCorners:
    return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), False


def _to_grid(points: object, board: Board) -> NDArray[np.float64]:
    """Return points of OpenCV as (rows, columns, 2)."""
    columns, rows = board.shape
    return np.asarray(points, dtype=np.float64).reshape(rows, columns, 2)


def _cell_areas(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the area (rows, columns) of the cell around each dot of a grid (rows, columns, 2), square pixels."""
    down, across = (np.asarray(np.gradient(grid, axis=axis)) for axis in (0, 1))
    return np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])


def _detect_blobs(grey: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres (M, 2) and diameters (M,) of all blobs that may be a dark dot on light, pixels."""
    import cv2

    if MAX_DOT_SHARE * min(grey.shape) <= MIN_DOT_PX:
        return np.zeros((0, 2)), np.zeros(0)
    settings = cv2.SimpleBlobDetector.Params()
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = THRESHOLDS
    settings.minDistBetweenBlobs = MIN_DOT_PX
    settings.blobColor = 0
    settings.minArea = np.pi / 4 * MIN_DOT_PX**2
    settings.maxArea = np.pi / 4 * (MAX_DOT_SHARE * min(grey.shape)) ** 2
    settings.minInertiaRatio = MIN_INERTIA_RATIO
    settings.minConvexity = MIN_CONVEXITY
    blobs = cv2.SimpleBlobDetector.create(settings).detect(grey)
    return np.array([blob.pt for blob in blobs]).reshape(-1, 2), np.array([blob.size for blob in blobs])


def _find_dot_grid(blobs: NDArray[np.float64], board: Board) -> NDArray[np.float64] | None:
    """Return the dots (N, 2) of the grid among all blobs (M, 2), row by row, or None if there is no such grid."""
    import cv2
    from scipy.spatial import KDTree

    if len(blobs) < board.columns * board.rows:
        return None
    spacing = float(np.median(KDTree(blobs).query(blobs, k=2)[0][:, 1]))
    scaled = (blobs * GRID_FINDER_PITCH_PX / max(spacing, 1e-6)).astype(np.float32).reshape(-1, 1, 2)
    # Clustering tolerates more perspective; the search without it tolerates more false dots.
    for flags in (cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING, cv2.CALIB_CB_SYMMETRIC_GRID):
        # The input is points already, so there is no detector; OpenCV's type stubs do not know this use.
        found, centres = cv2.findCirclesGrid(  # pyright: ignore[reportCallIssue]
            scaled,
            board.shape,
            flags,
            None,  # pyright: ignore[reportArgumentType]
            cv2.CirclesGridFinderParameters(),
        )
        if found:
            return blobs[KDTree(scaled.reshape(-1, 2)).query(np.asarray(centres).reshape(-1, 2))[1]]
    return None
