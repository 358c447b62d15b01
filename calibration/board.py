"""Calibration boards: what is printed on them, in the board's own frame."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BoardKind = Literal["charuco", "checkerboard", "circles"]


class BoardError(ValueError):
    """A board that cannot be."""

    slug = "calibration-board"


@dataclass(frozen=True)
class Board:
    """A flat board. Its frame: origin in the first corner (or dot), x along a row of corners, y to the next row,
    z = x cross y, which on a printed board points away from the viewer, into the paper."""

    kind: BoardKind = "charuco"
    columns: int = 9
    """Squares in a row of a chessboard (a ChArUco board's too); dots in a row of a circle grid."""
    rows: int = 7
    """Rows of squares, or of dots."""
    pitch_m: float = 0.025
    """Side of a square, or distance of neighbouring dots' centres, as measured on the print."""
    marker_m: float = 0.018
    """Side of a ChArUco board's markers."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the markers' dictionary."""

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) what is detected, by number, board frame: inner corners of a chessboard row by row, or dots."""
        inner = 0 if self.kind == "circles" else 1
        x, y = np.meshgrid(np.arange(self.columns - inner), np.arange(self.rows - inner))
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.pitch_m

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of what is printed, without a margin."""
        return self.columns * self.pitch_m, self.rows * self.pitch_m
