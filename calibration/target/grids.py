"""Finds checkerboards and circle grids, by OpenCV's detectors; all of the board must be in the image."""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_ordering import (
    larger_dot_elsewhere,
    order_by_colour,
    order_by_first_dot,
    right_handed,
)
from calibration.target.corner_refinement import refine_corners

Found = tuple[NDArray[np.int64], NDArray[np.float64], bool]
"""Numbers (N,) and pixels (N, 2) of what was found, and whether the image left no choice where to begin numbering."""

THRESHOLDS = (10, 230, 10)
"""Grey levels at which dots are looked for: the first, the last, the step. Blobs are joined over neighbouring ones, so
neither shade nor glare on part of the board matters."""
SMALLEST_DOT_PX = 5.0
"""Diameter; smaller ones cannot be told from noise."""
LARGEST_DOT = 0.2
"""Diameter, as a share of the image's shorter side."""
LEAST_INERTIA = 0.15
"""How round a dot is, least by greatest moment: a tilt of 65 degrees leaves this much of a circle."""
LEAST_CONVEXITY = 0.9
NEIGHBOURS_PX = 30.0
"""Distance of neighbouring dots that OpenCV's grid finder is made for; its settings are lengths in pixels."""


def find_checkerboard(grey: NDArray[np.uint8], board: Board) -> Found:
    """The inner corners seen in a grey image (H, W); none where not all of the board is seen."""
    import cv2

    for flags in (cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, corners = cv2.findChessboardCornersSB(grey, board.shape, flags=flags)
        if found:
            break
    else:
        return _nothing()
    grid = right_handed(_grid(corners, board))
    numbered, certain = order_by_colour(grid, grey, board)
    return *refine_corners(grey, board, board.points[:, :2], numbered.reshape(-1, 2)), certain


def find_circles(grey: NDArray[np.uint8], board: Board) -> Found:
    """The dots seen in a grey image (H, W), dark on light; none where not all of the board is seen.

    Raises:
        FirstDotElsewhereError: the larger dot is at a corner where the first one cannot be.
    """
    from scipy.spatial import KDTree

    places, diameters = _dots(grey)
    centres = _dot_grid(places, board)
    if centres is None:
        return _nothing()
    grid = right_handed(_grid(centres, board))
    sizes = diameters[KDTree(places).query(grid)[1]]
    numbered, sizes, certain = order_by_first_dot(grid, sizes)
    if not certain and board.columns != board.rows and larger_dot_elsewhere(sizes):
        raise FirstDotElsewhereError
    rough = numbered.reshape(-1, 2)
    # How large the dots are is not told with the board, and with perspective it decides where their middle is.
    ratios = sizes / np.sqrt(_cell_areas(numbered))
    common = round(float(np.median(ratios)), 2)
    first = round(float(ratios[0, 0]), 2) if certain else common
    return *refine_corners(grey, board, board.points[:, :2], rough, dots=(common, first)), certain


class FirstDotElsewhereError(ValueError):
    """Columns and rows are confused, or the image is mirrored."""


def _nothing() -> Found:
    return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), False


def _grid(points: object, board: Board) -> NDArray[np.float64]:
    columns, rows = board.shape
    return np.asarray(points, dtype=np.float64).reshape(rows, columns, 2)


def _cell_areas(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """(rows, columns) px: of the board's cell around each dot of a grid (rows, columns, 2)."""
    down, across = (np.asarray(np.gradient(grid, axis=axis)) for axis in (0, 1))
    return np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])


def _dots(grey: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (M, 2) and diameters (M,) of all that may be a dark dot on light, px."""
    import cv2

    if LARGEST_DOT * min(grey.shape) <= SMALLEST_DOT_PX:
        return np.zeros((0, 2)), np.zeros(0)
    settings = cv2.SimpleBlobDetector.Params()
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = THRESHOLDS
    settings.minDistBetweenBlobs = SMALLEST_DOT_PX
    settings.blobColor = 0
    settings.minArea = np.pi / 4 * SMALLEST_DOT_PX**2
    settings.maxArea = np.pi / 4 * (LARGEST_DOT * min(grey.shape)) ** 2
    settings.minInertiaRatio = LEAST_INERTIA
    settings.minConvexity = LEAST_CONVEXITY
    blobs = cv2.SimpleBlobDetector.create(settings).detect(grey)
    return np.array([blob.pt for blob in blobs]).reshape(-1, 2), np.array([blob.size for blob in blobs])


def _dot_grid(places: NDArray[np.float64], board: Board) -> NDArray[np.float64] | None:
    """The dots (N, 2) of the grid among all that may be dots, in rows; None: there is no such grid."""
    import cv2
    from scipy.spatial import KDTree

    if len(places) < board.columns * board.rows:
        return None
    apart = float(np.median(KDTree(places).query(places, k=2)[0][:, 1]))
    scaled = (places * NEIGHBOURS_PX / max(apart, 1e-6)).astype(np.float32).reshape(-1, 1, 2)
    # The one way bears more perspective, the other more of what is no dot.
    for flags in (cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING, cv2.CALIB_CB_SYMMETRIC_GRID):
        # No detector, as these are points already; OpenCV's types do not know of that.
        found, centres = cv2.findCirclesGrid(  # pyright: ignore[reportCallIssue]
            scaled,
            board.shape,
            flags,
            None,  # pyright: ignore[reportArgumentType]
            cv2.CirclesGridFinderParameters(),
        )
        if found:
            return places[KDTree(scaled.reshape(-1, 2)).query(np.asarray(centres).reshape(-1, 2))[1]]
    return None
