"""A board as it is printed: its black shapes to scale, and a picture of them.

The paper's drawing, the board of the simulated cell and the pictures that tests look at all come from here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

DOTS = (0.5, 0.8)
"""Diameters in pitches of a circle grid's dots, and of the first, which tells where the numbering begins. With half a
pitch neighbours do not run together when out of focus; the first has two and a half times the others' area."""
DISC_SAMPLES = 16
"""Per pixel and axis, where a disc's edge cuts it."""


@dataclass(frozen=True, eq=False)
class BoardShapes:
    """What is black on a board, in its frame (m). Nothing overlaps."""

    rectangles: NDArray[np.float64]
    """(N, 4) left, top, right, bottom: x0, y0, x1, y1 with x0 < x1 and y0 < y1."""
    discs: NDArray[np.float64]
    """(N, 3) centre x, y and radius."""


@dataclass(frozen=True, eq=False)
class BoardImage:
    """A board seen straight on, without perspective."""

    pixels: NDArray[np.uint8]
    """(H, W): 0 black, 255 white; grey only where an edge of a marker's cell or of a dot cuts a pixel, by the share of
    its area that is white."""
    pixels_per_m: float
    origin_px: tuple[float, float]
    """(x, y) of the board frame's origin; the centre of the first pixel is (0, 0). A point (x, y, 0) of the board is
    at `origin_px + pixels_per_m * (x, y)`."""


def board_shapes(board: Board, dots: tuple[float, float] = DOTS) -> BoardShapes:
    """What is to be printed black: squares and markers' cells, or dots of the diameters `dots` (in pitches; the second
    is the first dot's)."""
    if board.kind == "circles":
        radius = np.full((board.columns * board.rows, 1), dots[0] / 2 * board.pitch_m)
        radius[0] = dots[1] / 2 * board.pitch_m
        return BoardShapes(rectangles=np.zeros((0, 4)), discs=np.hstack([board.points[:, :2], radius]))
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    black = (column + row) % 2 == 0
    squares = np.column_stack([column[black], row[black], column[black] + 1, row[black] + 1]).astype(np.float64)
    squares = squares * board.pitch_m + np.tile(board.corner_of_print, 2)
    cells = _marker_cells(board) if board.kind == "charuco" else np.zeros((0, 4))
    return BoardShapes(rectangles=np.vstack([squares, cells]), discs=np.zeros((0, 3)))


def render_board(
    board: Board, pixels_per_pitch: int, margin_pitches: float = 1.0, dots: tuple[float, float] = DOTS
) -> BoardImage:
    """A picture of the board with `pixels_per_pitch` pixels to a pitch and a white margin of about `margin_pitches`
    pitches (a whole number of pixels) around it. `dots`: as for `board_shapes`.

    Raises:
        ValueError: fewer than one pixel per pitch, or a negative margin.
    """
    if pixels_per_pitch < 1 or not margin_pitches >= 0:
        raise ValueError(f"{pixels_per_pitch} pixels per pitch and a margin of {margin_pitches} pitches: no picture")
    margin = round(margin_pitches * pixels_per_pitch)
    width, height = (count * pixels_per_pitch + 2 * margin for count in (board.columns, board.rows))
    pixels_per_m = pixels_per_pitch / board.pitch_m
    shapes = board_shapes(board, dots)
    # In pixels from the picture's top left corner, which is half a pixel before the first pixel's centre.
    start = margin - np.array(board.corner_of_print) * pixels_per_m
    ink = np.zeros((height, width))
    for x0, y0, x1, y1 in shapes.rectangles * pixels_per_m + np.tile(start, 2):
        columns, across = _cut(x0, x1, width)
        rows, down = _cut(y0, y1, height)
        ink[rows, columns] += np.outer(down, across)
    for x, y, radius in shapes.discs * pixels_per_m + np.append(start, 0.0):
        columns, _ = _cut(x - radius, x + radius, width)
        rows, _ = _cut(y - radius, y + radius, height)
        across = _samples(columns) - x
        down = _samples(rows) - y
        inside = across**2 + down[:, None] ** 2 <= radius**2
        blocks = inside.reshape(rows.stop - rows.start, DISC_SAMPLES, columns.stop - columns.start, DISC_SAMPLES)
        ink[rows, columns] += blocks.mean(axis=(1, 3))
    return BoardImage(
        pixels=np.round(255.0 * np.clip(1.0 - ink, 0.0, 1.0)).astype(np.uint8),
        pixels_per_m=pixels_per_m,
        origin_px=(float(start[0]) - 0.5, float(start[1]) - 0.5),
    )


def _cut(low: float, high: float, count: int) -> tuple[slice, NDArray[np.float64]]:
    """Which of `count` pixels lie between two edges, and the share of each that does."""
    # An edge meant to lie between two pixels must not leave a trace of grey by rounding.
    low, high = (round(edge) if abs(edge - round(edge)) < 1e-6 else edge for edge in (low, high))
    first, last = max(int(np.floor(low)), 0), min(int(np.ceil(high)), count)
    starts = np.arange(first, last)
    return slice(first, last), np.minimum(starts + 1, high) - np.maximum(starts, low)


def _samples(pixels: slice) -> NDArray[np.float64]:
    count = (pixels.stop - pixels.start) * DISC_SAMPLES
    return pixels.start + (np.arange(count) + 0.5) / DISC_SAMPLES


def _marker_cells(board: Board) -> NDArray[np.float64]:
    """(N, 4) the markers' black cells, those beside one another in a row as one rectangle."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    across = dictionary.markerSize + 2  # with its black border, one cell wide
    cell = board.marker_m / across
    rectangles = []
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    white = (column + row) % 2 == 1
    inset = (board.pitch_m - board.marker_m) / 2
    for number, (c, r) in enumerate(zip(column[white], row[white], strict=True)):
        bits = dictionary.generateImageMarker(number, across) == 0
        left, top = np.array(board.corner_of_print) + np.array([c, r]) * board.pitch_m + inset
        for line, black in enumerate(bits):
            edges = np.flatnonzero(np.diff(black, prepend=False, append=False))
            for first, end in edges.reshape(-1, 2):
                rectangles.append((left + first * cell, top + line * cell, left + end * cell, top + (line + 1) * cell))
    return np.array(rectangles)
