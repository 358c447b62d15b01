"""Refine the corners (or dots) of a board in an image from their approximate positions.

The approximate positions predict how the surroundings of every corner look. This rendered patch is registered to the
image with OpenCV's enhanced correlation coefficient (ECC), which is invariant to brightness and contrast. All edges
around a corner contribute, also those of markers. The centre of a dot is right even where perspective shifts its
centroid.

On rendered images the error is 0.02 px. `cornerSubPix` has 0.1 to 0.3 px, `findChessboardCornersSB` 0.05 to 0.1 px, and
the centroids of blobs up to 0.9 px. Errors in the model of the print, such as the marker size or spreading ink, are
mostly symmetric about a corner and nearly cancel. A given marker size that is 5 % too large shifts corners by 0.05 px.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.rendering import DOT_DIAMETERS, BoardImage, render_board

HALF_WINDOW_PITCHES = 0.6
"""Half the side of a corner's patch, in pitches. Half a pitch reaches to the centres of the surrounding squares."""
DOT_MARGIN_PITCHES = 0.15
"""Margin of a dot's patch around the dot, in pitches. Its neighbours, whose size is uncertain, must stay outside."""
MIN_HALF_WINDOW_PX = 3
"""Minimum half side of a patch, pixels."""
MAX_HALF_WINDOW_PX = 10
"""Maximum half side of a square corner's patch, pixels. A larger patch is not more accurate: it only adds the inside of
markers, whose given size may be wrong, and more lens distortion."""
LENS_BLUR_PX = 0.7
"""Standard deviation of the assumed blur of an image, pixels."""
MIN_CORRELATION = 0.7
"""Minimum correlation of a patch with the image. Clear corners exceed 0.95, and badly focused ones 0.8."""
MAX_DECORRELATION_FACTOR, MAX_DECORRELATION_OFFSET = 5.0, 0.03
"""A corner is rejected if its decorrelation (1 - correlation) exceeds the image's median by this factor and this
offset. An obstacle such as a finger, a cable or glare then covers it."""
MAX_SHIFT_PITCHES = 0.2
"""Maximum distance of a refined corner from its predicted position, in pitches. A corner farther off is another
edge."""
BORDER_PX = 2.0
"""Minimum distance of a corner from the image border, pixels. Nearer corners have too little around them."""
NEIGHBOURS = 4
"""Number of known points whose mean residual predicts the lens distortion at a corner."""


def refine_corners(
    grey: NDArray[np.uint8],
    board: Board,
    on_board: NDArray[np.float64],
    in_image: NDArray[np.float64],
    max_distance_pitches: float = np.inf,
    dot_diameters: tuple[float, float] = DOT_DIAMETERS,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the corners of a board that are clearly visible in an image, located to a fraction of a pixel.

    Args:
        grey: (H, W) grey image.
        board: The board.
        on_board: (M, 2) known points in the board frame, metres. M >= 4, not on a line.
        in_image: (M, 2) approximate pixels of these points.
        max_distance_pitches: Corners farther than this from all known points are skipped, in pitches.
        dot_diameters: Diameters of the dots of a circle grid, as in `render_board`.

    Returns:
        Numbers (N,) of the corners, and their pixels (N, 2).
    """
    import cv2
    from scipy.spatial import KDTree

    H = np.asarray(cv2.findHomography(on_board, in_image, 0)[0], dtype=np.float64)
    points = board.points[:, :2]
    flat = apply_homography(H, points)
    # Lens distortion moves a corner by about as much as the known points around it.
    distance, neighbours = KDTree(on_board).query(points, k=NEIGHBOURS)
    guesses = flat + (in_image - apply_homography(H, on_board))[neighbours].mean(axis=1)
    pitch_px = _pitch_px(H, board)
    expected = _render_expected(grey.shape, board, H, float(np.median(pitch_px)), dot_diameters)
    ids, pixels, correlations = [], [], []
    half_px = _half_windows(board, pitch_px, dot_diameters)
    for number in np.flatnonzero(distance[:, 0] <= max_distance_pitches * board.pitch_m):
        half = int(half_px[number])
        max_shift = MAX_SHIFT_PITCHES * pitch_px[number]
        found = _register_patch(expected, flat[number], grey, guesses[number], half, int(np.ceil(max_shift)))
        if found is not None and np.linalg.norm(found[0] - guesses[number]) <= max_shift:
            ids.append(number)
            pixels.append(found[0])
            correlations.append(found[1])
    decorrelation = 1.0 - np.array(correlations)
    limit = MAX_DECORRELATION_FACTOR * float(np.median(decorrelation)) + MAX_DECORRELATION_OFFSET if ids else 0.0
    is_clear = decorrelation <= limit
    return np.array(ids, dtype=np.int64)[is_clear], np.array(pixels, dtype=np.float64).reshape(-1, 2)[is_clear]


def apply_homography(H: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points (N, 2) mapped by a homography (3, 3)."""
    result = points @ H[:, :2].T + H[:, 2]
    return result[:, :2] / result[:, 2:]


def _render_expected(
    shape: tuple[int, ...], board: Board, H: NDArray[np.float64], pitch_px: float, dot_diameters: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return the image (H, W) that a camera would have of the flat board."""
    import cv2

    # Rendered twice as fine as the image and blurred, it needs no further averaging. The resolution is rounded up, so
    # that one cached rendering serves many views.
    pixels = int(np.clip(16 * np.ceil(2 * pitch_px / 16), 16, 256))
    rendering = _render_cached(board, pixels, dot_diameters)
    scale, (x, y) = rendering.pixels_per_m, rendering.origin_px
    board_from_rendering = np.array([[1 / scale, 0.0, -x / scale], [0.0, 1 / scale, -y / scale], [0.0, 0.0, 1.0]])
    blurred = cv2.GaussianBlur(rendering.pixels, (0, 0), LENS_BLUR_PX * pixels / pitch_px)
    expected = cv2.warpPerspective(
        blurred, H @ board_from_rendering, (shape[1], shape[0]), borderMode=cv2.BORDER_CONSTANT, borderValue=255
    )
    return np.asarray(expected, dtype=np.uint8)


@lru_cache(maxsize=8)
def _render_cached(board: Board, pixels_per_pitch: int, dot_diameters: tuple[float, float]) -> BoardImage:
    return render_board(board, pixels_per_pitch, 0.5, dot_diameters)


def _register_patch(
    expected: NDArray[np.uint8],
    corner: NDArray[np.float64],
    grey: NDArray[np.uint8],
    guess: NDArray[np.float64],
    half: int,
    search: int,
) -> tuple[NDArray[np.float64], float] | None:
    """Register the patch of `expected` around `corner` to `grey` near `guess`; return its pixel and correlation."""
    import cv2

    last = np.array(grey.shape[::-1]) - 1
    if not ((guess >= BORDER_PX) & (guess <= last - BORDER_PX)).all():
        return None
    patch, patch_origin = _cut_window(expected, corner, half)
    search_window, search_origin = _cut_window(grey, guess, half + search + 1)
    if min(patch.shape + search_window.shape) <= MIN_HALF_WINDOW_PX:
        return None
    shift = guess - corner + patch_origin - search_origin
    warp = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]], dtype=np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-5)
    mask = np.full_like(search_window, 255)
    try:
        correlation, warp = cv2.findTransformECC(patch, search_window, warp, cv2.MOTION_TRANSLATION, stop, mask, 1)
    except cv2.error:  # OpenCV raises it if ECC does not converge, or if a window has a single colour.
        return None
    if not correlation >= MIN_CORRELATION:
        return None
    return corner + np.asarray(warp, dtype=np.float64)[:, 2] - patch_origin + search_origin, float(correlation)


def _cut_window(
    image: NDArray[np.uint8], centre: NDArray[np.float64], half: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the part of the image within `half` pixels of `centre`, and the (x, y) of its first pixel."""
    column, row = (round(float(c)) for c in centre)
    left, top = max(column - half, 0), max(row - half, 0)
    window = image[top : max(row + half + 1, 0), left : max(column + half + 1, 0)]
    return window, np.array([left, top], dtype=np.float64)


def _half_windows(board: Board, pitch_px: NDArray[np.float64], dot_diameters: tuple[float, float]) -> NDArray[np.int64]:
    """Return half the side (N,) of each corner's patch, pixels."""
    if board.kind == "circles":
        radii = np.full(len(pitch_px), dot_diameters[0] / 2)
        radii[0] = dot_diameters[1] / 2
        half = np.round((radii + DOT_MARGIN_PITCHES) * pitch_px)
    else:
        half = np.minimum(np.round(HALF_WINDOW_PITCHES * pitch_px), MAX_HALF_WINDOW_PX)
    return np.maximum(half, MIN_HALF_WINDOW_PX).astype(np.int64)


def _pitch_px(H: NDArray[np.float64], board: Board) -> NDArray[np.float64]:
    """Return the length (N,) of a pitch at each corner, pixels, in the direction in which it is shorter."""
    points, step = board.points[:, :2], board.pitch_m / 2
    across = apply_homography(H, points + [step, 0.0]) - apply_homography(H, points - [step, 0.0])
    down = apply_homography(H, points + [0.0, step]) - apply_homography(H, points - [0.0, step])
    return np.minimum(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1))
