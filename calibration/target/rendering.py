"""Draw the black shapes of a board to scale, and render an image of the board.

The printed page, the simulated cell, corner refinement and the tests use this module.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

DOT_DIAMETERS = (0.5, 0.8)
"""Diameters of the dots and of the first dot of a circle grid, in pitches. Dots of half a pitch stay separate in an
image that is out of focus. The larger first dot has about 2.5 times the area of another dot, and makes the numbering
unique."""
DISC_SAMPLES = 16
"""Number of samples per pixel and axis, to compute the part of a pixel that a disc covers."""
MAX_ROUNDING_PX = 1e-6
"""Maximum rounding error of an edge between two pixels, pixels."""


@dataclass(frozen=True, eq=False)
class BoardShapes:
    """The black shapes of a board, without overlap."""

    rectangles: NDArray[np.float64]
    """(N, 4) rectangles x0, y0, x1, y1 with x0 < x1 and y0 < y1, metres, board frame."""
    discs: NDArray[np.float64]
    """(N, 3) centre x, centre y and radius of the discs, metres, board frame."""


@dataclass(frozen=True, eq=False)
class BoardImage:
    """An orthographic image of a board, seen from the front."""

    pixels: NDArray[np.uint8]
    """(H, W) grey levels, from 0 for black to 255 for white. A partly black pixel has the mean grey level of its
    area."""
    pixels_per_m: float
    """Resolution, pixels per metre."""
    origin_px: tuple[float, float]
    """(x, y) of the origin of the board frame, pixels. The board point (x, y, 0) is at the pixel
    `origin_px + pixels_per_m * (x, y)`. The centre of the top left pixel is (0, 0)."""


def board_shapes(board: Board, dot_diameters: tuple[float, float] = DOT_DIAMETERS) -> BoardShapes:
    """Return the shapes of a board that are printed black.

    Args:
        board: The board.
        dot_diameters: Diameters of the dots and of the first dot of a circle grid, in pitches.

    Returns:
        The black squares and marker cells as rectangles, or the dots as discs.
    """
    if board.kind == "circles":
        radius = np.full((board.columns * board.rows, 1), dot_diameters[0] / 2 * board.pitch_m)
        radius[0] = dot_diameters[1] / 2 * board.pitch_m
        return BoardShapes(rectangles=np.zeros((0, 4)), discs=np.hstack([board.points[:, :2], radius]))
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    is_black = (column + row) % 2 == 0
    x = column[is_black]
    y = row[is_black]
    squares = np.column_stack([x, y, x + 1, y + 1]).astype(np.float64)
    squares = squares * board.pitch_m + np.tile(board.print_corner, 2)
    cells = np.zeros((0, 4))
    if board.kind == "charuco":
        cells = _marker_cells(board)
    return BoardShapes(rectangles=np.vstack([squares, cells]), discs=np.zeros((0, 3)))


def render_board(
    board: Board, pixels_per_pitch: int, margin_pitches: float = 1.0, dot_diameters: tuple[float, float] = DOT_DIAMETERS
) -> BoardImage:
    """Render an image of the board with a white margin.

    Args:
        board: The board.
        pixels_per_pitch: Resolution, pixels per pitch.
        margin_pitches: Width of the margin, in pitches. The margin is rounded to whole pixels.
        dot_diameters: Diameters of the dots and of the first dot of a circle grid, in pitches.

    Raises:
        ValueError: The resolution is below one pixel per pitch, or the margin is negative.
    """
    if pixels_per_pitch < 1 or not margin_pitches >= 0:
        raise ValueError(
            f"no image has {pixels_per_pitch} pixels per pitch and a margin of {margin_pitches} pitches: use at least "
            "one pixel per pitch and no negative margin"
        )
    margin = round(margin_pitches * pixels_per_pitch)
    width = board.columns * pixels_per_pitch + 2 * margin
    height = board.rows * pixels_per_pitch + 2 * margin
    pixels_per_m = pixels_per_pitch / board.pitch_m
    shapes = board_shapes(board, dot_diameters)
    # Origin of the board frame, in pixels from the outer corner of the top left pixel. The centre of this pixel is at
    # (0.5, 0.5).
    start = margin - np.array(board.print_corner) * pixels_per_m
    ink = np.zeros((height, width))
    for x0, y0, x1, y1 in shapes.rectangles * pixels_per_m + np.tile(start, 2):
        columns, across = _pixel_shares(x0, x1, width)
        rows, down = _pixel_shares(y0, y1, height)
        ink[rows, columns] += np.outer(down, across)
    for x, y, radius in shapes.discs * pixels_per_m + np.append(start, 0.0):
        columns, _ = _pixel_shares(x - radius, x + radius, width)
        rows, _ = _pixel_shares(y - radius, y + radius, height)
        across = _sample_positions(columns) - x
        down = _sample_positions(rows) - y
        inside = across**2 + down[:, None] ** 2 <= radius**2
        blocks = inside.reshape(rows.stop - rows.start, DISC_SAMPLES, columns.stop - columns.start, DISC_SAMPLES)
        ink[rows, columns] += blocks.mean(axis=(1, 3))
    return BoardImage(
        pixels=np.round(255.0 * np.clip(1.0 - ink, 0.0, 1.0)).astype(np.uint8),
        pixels_per_m=pixels_per_m,
        origin_px=(float(start[0]) - 0.5, float(start[1]) - 0.5),
    )


def _pixel_shares(low: float, high: float, count: int) -> tuple[slice, NDArray[np.float64]]:
    """Return the pixels between two edges on an axis of `count` pixels, and the covered fraction of each pixel."""
    low = _snap_to_pixel(low)
    high = _snap_to_pixel(high)
    first = max(int(np.floor(low)), 0)
    last = min(int(np.ceil(high)), count)
    starts = np.arange(first, last)
    return slice(first, last), np.minimum(starts + 1, high) - np.maximum(starts, low)


def _snap_to_pixel(edge: float) -> float:
    """Return the nearest whole number if `edge` differs by rounding only. Such an edge would leave a trace of grey."""
    nearest = round(edge)
    return nearest if abs(edge - nearest) < MAX_ROUNDING_PX else edge


def _sample_positions(pixels: slice) -> NDArray[np.float64]:
    """Return the positions of the `DISC_SAMPLES` samples in each of the given pixels, along one axis."""
    count = (pixels.stop - pixels.start) * DISC_SAMPLES
    return pixels.start + (np.arange(count) + 0.5) / DISC_SAMPLES


def _marker_cells(board: Board) -> NDArray[np.float64]:
    """Return the black marker cells as rectangles (N, 4), metres. Adjacent cells in a row form one rectangle."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    cells_per_side = dictionary.markerSize + 2  # The black border is one cell wide.
    cell = board.marker_m / cells_per_side
    rectangles = []
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    is_white = (column + row) % 2 == 1
    inset = (board.pitch_m - board.marker_m) / 2
    for number, (c, r) in enumerate(zip(column[is_white], row[is_white], strict=True)):
        bits = dictionary.generateImageMarker(number, cells_per_side) == 0
        left, top = np.array(board.print_corner) + np.array([c, r]) * board.pitch_m + inset
        for line, black in enumerate(bits):
            edges = np.flatnonzero(np.diff(black, prepend=False, append=False))
            for first, end in edges.reshape(-1, 2):
                rectangles.append((left + first * cell, top + line * cell, left + end * cell, top + (line + 1) * cell))
    return np.array(rectangles)
