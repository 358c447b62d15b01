"""Where exactly a board's corners (or dots) are in an image, once it is known roughly.

From the rough places follows how the surroundings of every corner ought to look. That picture is laid over the image
until it fits best (OpenCV's enhanced correlation coefficient, which does not mind light and contrast). All edges around
a corner take part, a marker's too, and a dot's middle is its middle also where perspective shifts its centroid.
Measured against `cornerSubPix`, `findChessboardCornersSB` and blobs' centroids on rendered images: 0.02 px, against
0.1 to 0.3, 0.05 to 0.1 and up to 0.9 px. What of the picture is not quite so on the print (the markers' size, ink that
spreads) is mostly so on both sides of a corner, and shifts it little: 0.05 px where markers are told 5 % too large.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.rendering import DOTS, BoardImage, render_board

HALF_WINDOW_PITCHES = 0.6
"""Half the side of what is laid over the image. Half a pitch reaches to the middle of the squares around."""
AROUND_DOT_PITCHES = 0.15
"""... and so much around a dot: its neighbours, whose size is known badly, must not take part."""
SMALLEST_HALF_WINDOW_PX = 3
LARGEST_HALF_WINDOW_PX = 10
"""Around a square's corner. More adds no exactness, but the inside of markers, whose size may be told wrong, and more
of what the lens bends."""
LENS_BLUR_PX = 0.7
"""Standard deviation of the blur that a picture is expected to have."""
LEAST_CORRELATION = 0.7
"""Of the surroundings with their picture. Seen well it is above 0.95, badly out of focus above 0.8."""
UNLIKE_OTHERS = 5.0, 0.03
"""A corner lacks so many times as much correlation as the image's corners mostly do, and this more, when something is
in the way: a finger, a cable, glare."""
FARTHEST_PITCHES = 0.2
"""A corner this far from where it was expected is another edge."""
INSIDE_PX = 2.0
"""A corner nearer to the image's border has too little around it."""
NEIGHBOURS = 4


def refine_corners(
    grey: NDArray[np.uint8],
    board: Board,
    known: NDArray[np.float64],
    seen: NDArray[np.float64],
    within_pitches: float = np.inf,
    dots: tuple[float, float] = DOTS,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers (N,) and pixels (N, 2) of the board's corners in a grey image (H, W): those that are seen as they ought
    to be.

    `seen` (M, 2) px is roughly where `known` (M, 2) m, board frame, are; M >= 4, not on a line. Corners farther than
    `within_pitches` from all of these are left out. `dots`: a circle grid's diameters, as for `render_board`.
    """
    import cv2
    from scipy.spatial import KDTree

    H = np.asarray(cv2.findHomography(known, seen, 0)[0], dtype=np.float64)
    points = board.points[:, :2]
    flat = apply_homography(H, points)
    # The lens bends what is flat: a corner about as much as what is known around it.
    distance, neighbours = KDTree(known).query(points, k=NEIGHBOURS)
    guesses = flat + (seen - apply_homography(H, known))[neighbours].mean(axis=1)
    pitch_px = _pitch_px(H, board)
    expected = _expected(grey.shape, board, H, float(np.median(pitch_px)), dots)
    ids, pixels, correlations = [], [], []
    half_px = _half_windows(board, pitch_px, dots)
    for number in np.flatnonzero(distance[:, 0] <= within_pitches * board.pitch_m):
        half = int(half_px[number])
        farthest = FARTHEST_PITCHES * pitch_px[number]
        found = _laid_over(expected, flat[number], grey, guesses[number], half, int(np.ceil(farthest)))
        if found is not None and np.linalg.norm(found[0] - guesses[number]) <= farthest:
            ids.append(number)
            pixels.append(found[0])
            correlations.append(found[1])
    times, more = UNLIKE_OTHERS
    lacking = 1.0 - np.array(correlations)
    clear = lacking <= (times * float(np.median(lacking)) + more if ids else 0.0)
    return np.array(ids, dtype=np.int64)[clear], np.array(pixels, dtype=np.float64).reshape(-1, 2)[clear]


def apply_homography(H: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 2) by a homography (3, 3)."""
    result = points @ H[:, :2].T + H[:, 2]
    return result[:, :2] / result[:, 2:]


def _expected(
    shape: tuple[int, ...], board: Board, H: NDArray[np.float64], pitch_px: float, dots: tuple[float, float]
) -> NDArray[np.uint8]:
    """The image (H, W) that a camera would have of the flat board."""
    import cv2

    # Twice as fine as the image, and blurred as by the lens and the pixels' size, it needs no more averaging. Rounded
    # up, so that one picture serves many views.
    pixels = int(np.clip(16 * np.ceil(2 * pitch_px / 16), 16, 256))
    picture = _picture(board, pixels, dots)
    scale, (x, y) = picture.pixels_per_m, picture.origin_px
    board_of_picture = np.array([[1 / scale, 0.0, -x / scale], [0.0, 1 / scale, -y / scale], [0.0, 0.0, 1.0]])
    blurred = cv2.GaussianBlur(picture.pixels, (0, 0), LENS_BLUR_PX * pixels / pitch_px)
    seen = cv2.warpPerspective(
        blurred, H @ board_of_picture, (shape[1], shape[0]), borderMode=cv2.BORDER_CONSTANT, borderValue=255
    )
    return np.asarray(seen, dtype=np.uint8)


@lru_cache(maxsize=8)
def _picture(board: Board, pixels_per_pitch: int, dots: tuple[float, float]) -> BoardImage:
    return render_board(board, pixels_per_pitch, 0.5, dots)


def _laid_over(
    expected: NDArray[np.uint8],
    corner: NDArray[np.float64],
    grey: NDArray[np.uint8],
    guess: NDArray[np.float64],
    half: int,
    search: int,
) -> tuple[NDArray[np.float64], float] | None:
    """Where the surroundings of `corner` in `expected` lie in `grey`, near `guess`, and how well they correlate; None:
    nowhere."""
    import cv2

    last = np.array(grey.shape[::-1]) - 1
    if not ((guess >= INSIDE_PX) & (guess <= last - INSIDE_PX)).all():
        return None
    window, start = _around(expected, corner, half)
    within, origin = _around(grey, guess, half + search + 1)
    if min(window.shape + within.shape) <= SMALLEST_HALF_WINDOW_PX:
        return None
    shift = guess - corner + start - origin
    warp = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]], dtype=np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-5)
    everywhere = np.full_like(within, 255)
    try:
        correlation, warp = cv2.findTransformECC(window, within, warp, cv2.MOTION_TRANSLATION, stop, everywhere, 1)
    except cv2.error:  # its way to say that it does not converge, or that a window is of one colour
        return None
    if not correlation >= LEAST_CORRELATION:
        return None
    return corner + np.asarray(warp, dtype=np.float64)[:, 2] - start + origin, float(correlation)


def _around(
    image: NDArray[np.uint8], middle: NDArray[np.float64], half: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """What of the image is within `half` pixels of `middle`, and the (x, y) of its first pixel."""
    column, row = (round(float(c)) for c in middle)
    left, top = max(column - half, 0), max(row - half, 0)
    window = image[top : max(row + half + 1, 0), left : max(column + half + 1, 0)]
    return window, np.array([left, top], dtype=np.float64)


def _half_windows(board: Board, pitch_px: NDArray[np.float64], dots: tuple[float, float]) -> NDArray[np.int64]:
    """(N,) half the side of each corner's window, px."""
    if board.kind == "circles":
        radii = np.full(len(pitch_px), dots[0] / 2)
        radii[0] = dots[1] / 2
        half = np.round((radii + AROUND_DOT_PITCHES) * pitch_px)
    else:
        half = np.minimum(np.round(HALF_WINDOW_PITCHES * pitch_px), LARGEST_HALF_WINDOW_PX)
    return np.maximum(half, SMALLEST_HALF_WINDOW_PX).astype(np.int64)


def _pitch_px(H: NDArray[np.float64], board: Board) -> NDArray[np.float64]:
    """(N,) how many pixels a pitch has at each corner, in the direction that has fewer."""
    points, step = board.points[:, :2], board.pitch_m / 2
    across = apply_homography(H, points + [step, 0.0]) - apply_homography(H, points - [step, 0.0])
    down = apply_homography(H, points + [0.0, step]) - apply_homography(H, points - [0.0, step])
    return np.minimum(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1))
