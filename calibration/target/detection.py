"""Detect a calibration board in an image."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import BoardImageError, BoardMirroredError, BoardNotSeenError
from calibration.target.board import MIN_CORNERS, Board
from calibration.target.charuco import count_markers, find_charuco
from calibration.target.grids import LargerDotMisplacedError, count_inner_corners, find_checkerboard, find_circles
from calibration.target.planarity import find_planar_corners

MIN_SPREAD_PITCHES = 0.25
"""Minimum rms distance of the corners from the line fitted to them, in pitches. For two full rows the distance is 0.5.
For a row of nine and one more corner it is 0.3."""
MIN_MEDIAN_GREY, MAX_MEDIAN_GREY = 25, 235
"""Range of the median grey level (0 to 255) of a well-exposed image."""
ADVICE = "light the board evenly without glare, move it into the middle of the image, and bring it into focus"
"""Advice in the message for a board that is not detected."""


@dataclass(frozen=True, eq=False)
class DetectedBoard:
    """The detected corners of a board in one image."""

    ids: NDArray[np.int64]
    """(N,) numbers of the corners or dots, ascending. A number is a row index of `Board.points`."""
    pixels: NDArray[np.float64]
    """(N, 2) positions of the corners or dots, x then y, pixels. The centre of the top left pixel is (0, 0)."""
    corner_sigma_px: float | None
    """Standard deviation of the corner noise per coordinate, pixels, estimated from the residuals to a flat board. None
    if the corners are too few for an estimate."""
    is_numbering_unique: bool = True
    """Whether the image determines the first corner. If False, all numberings that
    `calibration.target.corner_ordering.symmetric_numberings` returns are possible."""


def detect_board(image: NDArray[np.uint8], board: Board) -> DetectedBoard:
    """Detect the corners of a board in an image.

    A ChArUco board may be partly visible. A checkerboard or circle grid must be completely visible.

    Args:
        image: (H, W) grey or (H, W, 3) BGR image of 8-bit pixels.
        board: The board to detect.

    Returns:
        The detected corners: at least `MIN_CORNERS`, not all on one line.

    Raises:
        BoardImageError: The array is not an 8-bit image.
        BoardNotSeenError: Fewer than `MIN_CORNERS` corners are visible, all corners are on one line, or the larger dot
            is at the wrong corner of a circle grid.
        BoardMirroredError: The image shows the ChArUco board mirrored. Other boards are not checked for mirroring.
    """
    grey = _to_grey(image)
    ids, pixels, is_unique = _find_corners(grey, board)
    if board.kind == "charuco" and len(ids) < MIN_CORNERS:
        _raise_if_mirrored(grey, board)
    if len(ids) == 0 and board.kind == "checkerboard":
        _raise_if_other_count(grey, board)
    if len(ids) == 0:
        raise BoardNotSeenError(
            f"{_describe_no_corners(grey, board)}{_describe_exposure(grey)}: {ADVICE}, and check that it is {board}"
        )
    if len(ids) < MIN_CORNERS:
        raise BoardNotSeenError(
            f"only {len(ids)} corners of the board ({board}) are visible, and at least {MIN_CORNERS} are needed"
            f"{_describe_exposure(grey)}: {ADVICE}, and remove what covers it"
        )
    if _are_collinear(board, ids):
        raise BoardNotSeenError(
            f"the {len(ids)} visible corners of the board ({board}) lie on a line, which does not determine its pose: "
            "bring more of it into the image"
        )
    inliers, sigma = find_planar_corners(board, ids, pixels)
    return DetectedBoard(ids=ids[inliers], pixels=pixels[inliers], corner_sigma_px=sigma, is_numbering_unique=is_unique)


def _to_grey(image: Any) -> NDArray[np.uint8]:
    """Convert an image to contiguous grey pixels (H, W), uint8."""
    import cv2

    if not isinstance(image, np.ndarray):
        raise BoardImageError(f"the image has a {type(image).__name__}: convert it to 8-bit pixels (uint8)")
    if image.dtype != np.uint8:
        raise BoardImageError(f"the image has numbers of type {image.dtype}: convert it to 8-bit pixels (uint8)")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise BoardImageError(f"the image has the shape {image.shape}: (H, W) grey or (H, W, 3) BGR is needed")
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _find_corners(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.int64], NDArray[np.float64], bool]:
    """Return the numbers (N,) and pixels (N, 2) of the corners, and whether the numbering is unique."""
    match board.kind:
        case "charuco":
            ids, pixels = find_charuco(grey, board)
            return ids, pixels, True
        case "checkerboard":
            return find_checkerboard(grey, board)
        case "circles":
            try:
                return find_circles(grey, board)
            except LargerDotMisplacedError:
                raise BoardNotSeenError(
                    f"the larger dot of the circle grid is not at a corner where a grid of {board.columns} columns and "
                    f"{board.rows} rows begins: hold the grid with the larger dot at the upper left, give the number "
                    "of dots in its row as columns, and check that the image is not mirrored"
                ) from None


def _raise_if_mirrored(grey: NDArray[np.uint8], board: Board) -> None:
    """Raise BoardMirroredError if the mirrored image shows the board."""
    ids, _ = find_charuco(np.ascontiguousarray(grey[:, ::-1]), board)
    if len(ids) >= MIN_CORNERS:
        raise BoardMirroredError(
            f"the board is detected only in the mirrored image, with {len(ids)} corners: switch off the camera's "
            "flip or mirror setting, or remove the mirror between camera and board"
        )


def _raise_if_other_count(grey: NDArray[np.uint8], board: Board) -> None:
    """Raise BoardNotSeenError if the image shows a checkerboard with one square more or less along a side."""
    counted = count_inner_corners(grey, board)
    if counted is None:
        return
    inner_columns, inner_rows = counted
    columns = inner_columns + 1
    rows = inner_rows + 1
    raise BoardNotSeenError(
        f"a checkerboard with {inner_columns} x {inner_rows} inner corners ({columns} x {rows} squares) is visible, "
        f"and {board.shape[0]} x {board.shape[1]} inner corners ({board.columns} x {board.rows} squares) were given: "
        f"give the number of squares, columns {columns} and rows {rows}"
    )


def _describe_no_corners(grey: NDArray[np.uint8], board: Board) -> str:
    if board.kind != "charuco":
        what = "dots" if board.kind == "circles" else "squares"
        return f"the board is not detected, which needs all of its {board.columns} x {board.rows} {what} in the image"
    markers = count_markers(grey, board)
    if markers == 0:
        return f"neither the board nor any of its markers ({board.dictionary}) is detected"
    return f"the board is not detected; {markers} markers of {board.dictionary} are, but not arranged as on this board"


def _describe_exposure(grey: NDArray[np.uint8]) -> str:
    median = float(np.median(grey))
    if median < MIN_MEDIAN_GREY:
        return f" (the image is dark, its median grey level is {median:.0f} of 255)"
    if median > MAX_MEDIAN_GREY:
        return f" (the image is very bright, its median grey level is {median:.0f} of 255)"
    return ""


def _are_collinear(board: Board, ids: NDArray[np.int64]) -> bool:
    """Return whether the corners with the numbers `ids` (N,) lie nearly on one line of the board."""
    points = board.points[ids, :2] / board.pitch_m
    _, across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(across < MIN_SPREAD_PITCHES * np.sqrt(len(ids)))
