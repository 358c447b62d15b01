"""Finds the corners of a ChArUco board: OpenCV's marker detector says which square is where, and
`calibration.target.corner_refinement` where exactly the corners between them are.

OpenCV's own `CharucoDetector` refines with `cornerSubPix`, whose window must end before the markers begin. Where a
square has 17 pixels (640 x 400 at 0.6 m) and is tilted by 30 degrees, it finds 45 % of the corners, off by 0.28 px
rms; this finds all, off by 0.02 px.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import refine_corners

ENLARGED_UP_TO_PX = 1_100_000
"""Images up to this size are looked at twice as large: a marker's cell of two pixels is read badly. Larger ones would
take long, and have more pixels anyway."""
PIXELS_PER_CELL = 8
"""A marker is straightened to so many pixels per cell before its bits are read."""
IGNORED_OF_CELL = 0.2
"""Of a cell's side at each edge, when its bit is read: blurred by the neighbours."""
CORRECTED = 1.0
"""Share of the bit errors that the dictionary can correct which are corrected. OpenCV's 0.6 guards against markers
that are none; here a marker must also be where the board has it."""
FEWEST_MARKERS = 2
MARKER_OFF = 0.25
"""A marker's corner may be that far from where a flat board has it, in markers' sides: what the lens bends."""
LEAST_AGREEING = 0.6
"""Of the markers read. Another board of the same dictionary has some of them in the same places, as the first row's."""
NEAR_PITCHES = 4.0
"""A corner is looked for only so near to a marker that was read."""


def find_charuco(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers (N,) and pixels (N, 2) of the corners seen in a grey image (H, W); N is 0 where there is no board."""
    known, seen = _agreeing(*_markers(grey, board))
    if len(known) < FEWEST_MARKERS * 4:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return refine_corners(grey, board, known, seen, within_pitches=NEAR_PITCHES)


def count_markers(grey: NDArray[np.uint8], board: Board) -> int:
    """How many of the board's markers are read in a grey image (H, W), wherever they are."""
    return len(_markers(grey, board)[0]) // 4


def _markers(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the markers read that are on the board: (4 M, 2) where they are on it, m, and in the image, px."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    settings = cv2.aruco.DetectorParameters()
    settings.perspectiveRemovePixelPerCell = PIXELS_PER_CELL
    settings.perspectiveRemoveIgnoredMarginPerCell = IGNORED_OF_CELL
    settings.errorCorrectionRate = CORRECTED
    factor = 2 if grey.size <= ENLARGED_UP_TO_PX else 1
    image = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else grey
    quads, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
    if numbers is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    layout = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    # OpenCV's origin is the outermost corner of the print.
    places = np.array(layout.getObjPoints(), dtype=np.float64)[:, :, :2] + np.array(board.corner_of_print)
    found = np.asarray(numbers, dtype=np.int64).ravel()
    ours = found < len(places)
    seen = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)[ours].reshape(-1, 2)
    return places[found[ours]].reshape(-1, 2), (seen + 0.5) / factor - 0.5


def _agreeing(known: NDArray[np.float64], seen: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Those markers' corners that lie as on one flat board."""
    import cv2

    if len(known) < FEWEST_MARKERS * 4:
        return known, seen
    quads = seen.reshape(-1, 4, 2)
    side = float(np.median(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2)))
    H, mask = cv2.findHomography(known, seen, cv2.RANSAC, max(MARKER_OFF * side, 1.0))
    if H is None or not np.isfinite(H).all():
        return known[:0], seen[:0]
    # A marker is read right or wrong as a whole.
    markers = np.asarray(mask, dtype=bool).reshape(-1, 4).all(axis=1)
    if markers.mean() < LEAST_AGREEING:
        return known[:0], seen[:0]
    agree = np.repeat(markers, 4)
    return known[agree], seen[agree]
