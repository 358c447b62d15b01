"""Detect checkerboards and circle grids with OpenCV. The whole board must be visible."""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_ordering import (
    is_larger_dot_misplaced,
    make_right_handed,
    order_from_black_square,
    order_from_larger_dot,
)
from calibration.target.corner_refinement import KnownPoints, refine_corners

GridCorners = tuple[NDArray[np.int64], NDArray[np.float64], bool]
"""Numbers (N,) and pixels (N, 2) of the detected points, and whether the image determines the first point."""

MIN_CONTRAST_SHARE = 0.4
"""Minimum ratio of the contrast between black and white in a row of squares to the median contrast of all rows and
columns."""
MIN_INNER_CORNERS = 3
"""Minimum number of inner corners along a side that OpenCV can detect."""
THRESHOLDS = (10, 230, 10)
"""Grey-level thresholds of the blob detector: first, last, step. Many thresholds make the detection robust to shadow or
glare on part of the board."""
MIN_DOT_PX = 5.0
"""Minimum diameter of a dot, pixels. A smaller dot cannot be distinguished from noise."""
MAX_DOT_SHARE = 0.2
"""Maximum ratio of the dot diameter to the shorter image side."""
MIN_INERTIA_RATIO = 0.15
"""Minimum ratio of the smallest to the largest second moment of a dot. A circle tilted by 67 degrees has this ratio."""
MIN_CONVEXITY = 0.9
"""Minimum ratio of the dot area to the area of its convex hull."""
GRID_FINDER_PITCH_PX = 30.0
"""Distance between neighbouring dots after scaling the blob positions, pixels. The default settings of OpenCV's grid
finder suit this distance."""


class LargerDotMisplacedError(ValueError):
    """The larger dot is at a corner that cannot be the first.

    Columns and rows are swapped in the board description, or the image is mirrored.
    """


def find_checkerboard(grey: NDArray[np.uint8], board: Board) -> GridCorners:
    """Detect the inner corners of a checkerboard.

    Args:
        grey: (H, W) grey image.
        board: The board, of the kind `checkerboard`.

    Returns:
        Numbers (N,), pixels (N, 2), and whether the colours determine the first corner. N is 0 if the board is not
        detected.
    """
    import cv2

    for flags in (cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, corners = cv2.findChessboardCornersSB(grey, board.shape, flags=flags)
        if found:
            break
    else:
        return _no_corners()
    grid = make_right_handed(_to_grid(corners, board))
    ordered, is_unique = order_from_black_square(grid, grey, board)
    known = KnownPoints(board.points[:, :2], ordered.reshape(-1, 2))
    ids, pixels = refine_corners(grey, board, known)
    return ids, pixels, is_unique


def count_inner_corners(grey: NDArray[np.uint8], board: Board) -> tuple[int, int] | None:
    """Return the numbers of inner corners of a checkerboard whose size is nearly that of `board`.

    The numbers of inner corners along both sides may differ from those of `board` by one. A board that was described
    by its inner corners instead of its squares is therefore counted.

    Args:
        grey: (H, W) grey image.
        board: The board that was not detected, of the kind `checkerboard`.

    Returns:
        Inner corners along the columns and the rows of `board`, or None if no such board is visible.
    """
    import cv2

    columns, rows = board.shape
    # The larger sizes first, because a smaller size can be found within a larger board.
    for more_columns, more_rows in sorted(np.ndindex(3, 3), key=sum, reverse=True):
        shape = (columns + more_columns - 1, rows + more_rows - 1)
        if shape == board.shape or min(shape) < MIN_INNER_CORNERS:
            continue
        found, corners = cv2.findChessboardCornersSB(grey, shape, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        # The border of the board can be taken for a further row of corners.
        if found and _has_contrast_everywhere(np.asarray(corners, dtype=np.float64).reshape(*shape[::-1], 2), grey):
            return shape
    return None


def find_circles(grey: NDArray[np.uint8], board: Board) -> GridCorners:
    """Detect the dots of a circle grid. The dots are dark on a light background.

    Args:
        grey: (H, W) grey image.
        board: The board, of the kind `circles`.

    Returns:
        Numbers (N,), pixels (N, 2), and whether a larger dot determines the first dot. N is 0 if the board is not
        detected.

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
    known = KnownPoints(board.points[:, :2], ordered.reshape(-1, 2))
    # `Board` has no dot size, but refinement needs it: under perspective, the centroid shifts with the dot size.
    ratios = diameters / np.sqrt(_cell_areas(ordered))
    common = round(float(np.median(ratios)), 2)
    first = round(float(ratios[0, 0]), 2) if is_unique else common
    ids, pixels = refine_corners(grey, board, known, dot_diameters=(common, first))
    return ids, pixels, is_unique


def _has_contrast_everywhere(grid: NDArray[np.float64], grey: NDArray[np.uint8]) -> bool:
    """Return whether black and white alternate in all rows and columns of squares, also in those at the border.

    `grid` (rows, columns, 2) are the pixels of the inner corners.
    """
    for axis in (0, 1):  # Extrapolate to the border of the board.
        lines = np.moveaxis(grid, axis, 0)
        before = 2 * lines[0] - lines[1]
        after = 2 * lines[-1] - lines[-2]
        grid = np.moveaxis(np.concatenate([before[None], lines, after[None]]), 0, axis)
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    column, row = np.clip(np.round(centres), 0, np.array(grey.shape[::-1]) - 1).astype(np.int64).transpose(2, 0, 1)
    values = grey[row, column].astype(np.float64)
    is_first = np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2 == 0
    lines = zip([*values, *values.T], [*is_first, *is_first.T], strict=True)
    contrasts = np.abs([line[first].mean() - line[~first].mean() for line, first in lines])
    return bool(contrasts.min() > MIN_CONTRAST_SHARE * np.median(contrasts))


def _no_corners() -> GridCorners:
    return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), False


def _to_grid(points: object, board: Board) -> NDArray[np.float64]:
    """Reshape an OpenCV point list to a grid (rows, columns, 2)."""
    columns, rows = board.shape
    return np.asarray(points, dtype=np.float64).reshape(rows, columns, 2)


def _cell_areas(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cell areas (rows, columns), square pixels, of a grid of dots (rows, columns, 2)."""
    down = np.asarray(np.gradient(grid, axis=0))
    across = np.asarray(np.gradient(grid, axis=1))
    return np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])


def _detect_blobs(grey: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres (M, 2) and diameters (M,) of all dark blobs with the size and shape of a dot, pixels."""
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
    """Select the dots (N, 2) of the grid, row by row, from the blob centres (M, 2). Return None if no grid is found."""
    import cv2
    from scipy.spatial import KDTree

    if len(blobs) < board.columns * board.rows:
        return None
    spacing = float(np.median(KDTree(blobs).query(blobs, k=2)[0][:, 1]))
    scaled = (blobs * GRID_FINDER_PITCH_PX / max(spacing, 1e-6)).astype(np.float32).reshape(-1, 1, 2)
    # Clustering tolerates more perspective. The search without clustering tolerates more false dots.
    for flags in (cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING, cv2.CALIB_CB_SYMMETRIC_GRID):
        # The input is a list of points, so the blob detector is None. OpenCV's type stubs do not allow None.
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
