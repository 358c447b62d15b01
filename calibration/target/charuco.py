"""Detect ChArUco boards: OpenCV reads the markers, and `corner_refinement` locates the corners between the markers.

OpenCV's `CharucoDetector` refines corners with `cornerSubPix`. The search window of `cornerSubPix` is small, because it
must not reach a marker. On squares of 17 pixels (640 x 400 at 0.6 m) with a tilt of 30 degrees, `CharucoDetector` finds
45 % of the corners, with an rms error of 0.28 px. This module finds all corners, with an error of 0.02 px.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import KnownPoints, refine_corners

MAX_UPSCALED_PX = 1_100_000
"""Maximum number of pixels of an image that is upscaled by two. Upscaling helps to read marker cells of two pixels. A
larger image has more pixels per cell, and upscaling it would be slow."""
PIXELS_PER_CELL = 8
"""Side of a marker cell in the rectified marker image, pixels. OpenCV reads the bits from this image."""
IGNORED_CELL_MARGIN = 0.2
"""Margin of a marker cell that is ignored when its bit is read, as a fraction of the cell side. Neighbouring cells blur
into this margin."""
ERROR_CORRECTION_RATE = 1.0
"""Fraction of the dictionary's correctable bit errors that are corrected. OpenCV's default of 0.6 avoids false markers.
This module rejects false markers by their position on the board."""
MIN_MARKERS = 2
"""Minimum number of markers that must be read to detect a board."""
MAX_MARKER_DEVIATION = 0.25
"""Maximum distance of a marker corner from its predicted position on a flat board, in marker sides. The limit allows
for lens distortion."""
MIN_CONSISTENT_SHARE = 0.6
"""Minimum fraction of the read markers that are consistent with one flat board. The fraction is lower for another board
with the same dictionary, which has only some markers (for example the first row) at the same positions."""
MAX_MARKER_DISTANCE_PITCHES = 4.0
"""Maximum distance of a corner from the nearest corner of a read marker, in pitches. Corners farther away are not
searched."""


def find_charuco(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Detect the inner corners of a ChArUco board in an image.

    Args:
        grey: (H, W) grey image.
        board: The board, of the kind `charuco`.

    Returns:
        Numbers (N,) and pixels (N, 2) of the detected corners. N is 0 if the board is not detected.
    """
    known = _select_consistent(_detect_markers(grey, board))
    if len(known) < MIN_MARKERS * 4:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return refine_corners(grey, board, known, max_distance_pitches=MAX_MARKER_DISTANCE_PITCHES)


def count_markers(grey: NDArray[np.uint8], board: Board) -> int:
    """Count the markers of the board that are read in a grey image (H, W). Their positions are not checked."""
    return len(_detect_markers(grey, board)) // 4


def _detect_markers(grey: NDArray[np.uint8], board: Board) -> KnownPoints:
    """Detect M markers. Return their corners, four for each marker."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.perspectiveRemovePixelPerCell = PIXELS_PER_CELL
    settings.perspectiveRemoveIgnoredMarginPerCell = IGNORED_CELL_MARGIN
    settings.errorCorrectionRate = ERROR_CORRECTION_RATE
    factor = 2 if grey.size <= MAX_UPSCALED_PX else 1
    image = grey
    if factor > 1:
        image = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    quads, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
    if numbers is None:
        return KnownPoints(np.zeros((0, 2)), np.zeros((0, 2)))
    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    # OpenCV's origin is the top left corner of the print.
    positions = np.array(layout.getObjPoints(), dtype=np.float64)[:, :, :2] + np.array(board.print_corner)
    found = np.asarray(numbers, dtype=np.int64).ravel()
    is_on_board = found < len(positions)
    in_image = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)[is_on_board].reshape(-1, 2)
    # The centre of the top left pixel is (0, 0) in both images.
    return KnownPoints(positions[found[is_on_board]].reshape(-1, 2), (in_image + 0.5) / factor - 0.5)


def _select_consistent(corners: KnownPoints) -> KnownPoints:
    """Keep the corners of the markers that are consistent with one flat board.

    Args:
        corners: Marker corners, four for each marker.

    Returns:
        The kept corners; none if too few markers are consistent.
    """
    import cv2

    if len(corners) < MIN_MARKERS * 4:
        return corners
    quads = corners.in_image.reshape(-1, 4, 2)
    side = float(np.median(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2)))
    max_deviation_px = max(MAX_MARKER_DEVIATION * side, 1.0)
    H, mask = cv2.findHomography(corners.on_board, corners.in_image, cv2.RANSAC, max_deviation_px)
    if H is None or not np.isfinite(H).all():
        return corners[:0]
    # Reject a marker if one of its four corners is an outlier.
    is_consistent = np.asarray(mask, dtype=bool).reshape(-1, 4).all(axis=1)
    if is_consistent.mean() < MIN_CONSISTENT_SHARE:
        return corners[:0]
    return corners[np.repeat(is_consistent, 4)]
