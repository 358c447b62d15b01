"""Finds a calibration board in an image."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import BoardImageError, BoardMirroredError, BoardNotSeenError
from calibration.target.board import FEWEST_CORNERS, Board
from calibration.target.charuco import count_markers, find_charuco
from calibration.target.corner_ordering import symmetric_numberings
from calibration.target.grids import FirstDotElsewhereError, find_checkerboard, find_circles
from calibration.target.planarity import check_planarity

__all__ = ["BoardSighting", "detect_board", "symmetric_numberings"]

SPREAD_PITCHES = 0.25
"""Corners are on a line when they deviate less from it (rms): two rows do by 0.5, a row of nine and one more by 0.3."""
DARK, BRIGHT = 25, 235
"""Grey levels; an image whose median is beyond is under- or overexposed."""
ADVICE = "light the board evenly without glare, move it into the middle of the image, and bring it into focus"


@dataclass(frozen=True, eq=False)
class BoardSighting:
    """What an image shows of a board."""

    ids: NDArray[np.int64]
    """(N,) numbers of the corners or dots seen, ascending: rows of `Board.points`. At least six, not on a line."""
    pixels: NDArray[np.float64]
    """(N, 2) where, x then y; the centre of the first pixel is (0, 0)."""
    corner_sigma_px: float | None
    """Standard deviation of one coordinate, by how well they lie on a flat board; None: too few corners to tell."""
    numbered: bool = True
    """Whether the image told which corner is the first; if not, see `symmetric_numberings`."""


def detect_board(image: NDArray[np.uint8], board: Board) -> BoardSighting:
    """The corners of `board` in an image, (H, W) grey or (H, W, 3) BGR.

    Of a ChArUco board a part is enough; of a checkerboard or a circle grid all of it must be in the image.

    Raises:
        BoardImageError: not an 8-bit image.
        BoardNotSeenError: fewer than six corners, or all on a line.
        BoardMirroredError: a ChArUco board is seen, in a mirror image. Of other boards this cannot be told.
    """
    grey = _grey(image)
    ids, pixels, numbered = _found(grey, board)
    if board.kind == "charuco" and len(ids) < FEWEST_CORNERS:
        _refuse_mirrored(grey, board)
    if len(ids) == 0:
        raise BoardNotSeenError(
            f"{_nothing_seen(grey, board)}{_exposure(grey)}: {ADVICE}, and check that it is {board}"
        )
    if len(ids) < FEWEST_CORNERS:
        raise BoardNotSeenError(
            f"only {len(ids)} corners of the board ({board}) are seen, and {FEWEST_CORNERS} are needed"
            f"{_exposure(grey)}: {ADVICE}, and clear away what hides it"
        )
    if _on_a_line(board, ids):
        raise BoardNotSeenError(
            f"the {len(ids)} corners seen of the board ({board}) lie on a line, from which its pose does not follow: "
            "bring more of it into the image"
        )
    agree, sigma = check_planarity(board, ids, pixels)
    return BoardSighting(ids=ids[agree], pixels=pixels[agree], corner_sigma_px=sigma, numbered=numbered)


def _grey(image: Any) -> NDArray[np.uint8]:
    import cv2

    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        kind = f"numbers of type {image.dtype}" if isinstance(image, np.ndarray) else f"a {type(image).__name__}"
        raise BoardImageError(f"the image has {kind}: 8-bit pixels (uint8) are needed, convert it first")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise BoardImageError(f"the image has the shape {image.shape}: (H, W) grey or (H, W, 3) BGR is needed")
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _found(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.int64], NDArray[np.float64], bool]:
    match board.kind:
        case "charuco":
            return *find_charuco(grey, board), True
        case "checkerboard":
            return find_checkerboard(grey, board)
        case "circles":
            try:
                return find_circles(grey, board)
            except FirstDotElsewhereError:
                raise BoardNotSeenError(
                    f"the circle grid's larger dot is not at a corner where a grid of {board.columns} columns and "
                    f"{board.rows} rows begins: give as columns how many dots follow the larger one when it is held at "
                    "the upper left, and check that the image is not mirrored"
                ) from None


def _refuse_mirrored(grey: NDArray[np.uint8], board: Board) -> None:
    ids, _ = find_charuco(np.ascontiguousarray(grey[:, ::-1]), board)
    if len(ids) >= FEWEST_CORNERS:
        raise BoardMirroredError(
            f"the board is seen only when the image is mirrored, then with {len(ids)} corners: switch off the camera's "
            "flip or mirror setting, or take the board out of the mirror"
        )


def _nothing_seen(grey: NDArray[np.uint8], board: Board) -> str:
    if board.kind != "charuco":
        what = "dots" if board.kind == "circles" else "squares"
        return f"the board is not seen, which needs all of its {board.columns} x {board.rows} {what} in the image"
    markers = count_markers(grey, board)
    if markers == 0:
        return f"the board is not seen, and none of its markers ({board.dictionary}) is"
    return f"the board is not seen; {markers} markers of {board.dictionary} are, but not as on this board"


def _exposure(grey: NDArray[np.uint8]) -> str:
    median = float(np.median(grey))
    if median < DARK:
        return f" (the image is dark, its median grey level is {median:.0f} of 255)"
    if median > BRIGHT:
        return f" (the image is very bright, its median grey level is {median:.0f} of 255)"
    return ""


def _on_a_line(board: Board, ids: NDArray[np.int64]) -> bool:
    places = board.points[ids, :2] / board.pitch_m
    _, across = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(across < SPREAD_PITCHES * np.sqrt(len(ids)))
