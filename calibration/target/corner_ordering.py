"""Which corner of a chessboard, or dot of a grid, is the first: what the image tells, and what it leaves open.

A plain grid looks the same from more than one side. A checkerboard with an even and an odd number of squares along its
sides does not, for the colours, nor does a circle grid whose first dot is larger. For the others a numbering is chosen
that is one of those that `symmetric_numberings` gives: views that are to be used together have to be made to
agree, by trying.
A mirrored image of a plain grid is the image of another plain grid, and is not noticed.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

LARGER = 1.25
"""So much larger than the dots around it is the first dot, in diameters."""


def symmetric_numberings(board: Board) -> list[NDArray[np.int64]]:
    """All (N,) permutations under which the board looks the same: corner `i` may as well be corner `p[i]`, so that
    `ids` of a view may as well be `p[ids]`. The first leaves everything as it is; a ChArUco board has no other.

    A circle grid is taken to have no larger first dot; where a view shows one (`BoardSighting.numbered`), there is
    nothing to try.
    """
    columns, rows = board.shape
    numbers = np.arange(columns * rows).reshape(rows, columns)
    if board.kind == "charuco":
        return [numbers.ravel()]
    return [turned.ravel() for turned in _turns(numbers) if board.kind == "circles" or _same_colours(board, turned)]


def right_handed(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """The grid (rows, columns, 2) of pixels, its rows turned about if it is numbered as in a mirror: as seen from the
    front, y is a quarter turn clockwise of x."""
    (xx, xy), (yx, yy) = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    return grid if xx * yy - xy * yx > 0 else grid[:, ::-1]


def order_by_colour(
    grid: NDArray[np.float64], grey: NDArray[np.uint8], board: Board
) -> tuple[NDArray[np.float64], bool]:
    """A checkerboard's corners (rows, columns, 2) so that its first square is black, and whether that leaves no
    choice."""
    numbers = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
    candidates = [grid.reshape(-1, 2)[turned] for turned in _turns(numbers)]
    right = [candidate for candidate in candidates if _first_is_black(candidate, grey)]
    return _upmost(right or candidates), len(symmetric_numberings(board)) == 1 and len(right) == 1


def order_by_first_dot(
    grid: NDArray[np.float64], diameters: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """A circle grid's dots (rows, columns, 2) and their diameters (rows, columns) so that the larger dot is the first,
    and whether there is one; it may be at another corner than a grid of this many columns and rows can begin with."""
    numbers = np.arange(diameters.size).reshape(diameters.shape)
    candidates = [(grid.reshape(-1, 2)[turned], diameters.ravel()[turned]) for turned in _turns(numbers)]
    # Compared with the dots around, as perspective makes the near ones larger.
    ratios = [sizes[0, 0] / np.median([sizes[0, 1], sizes[1, 0], sizes[1, 1]]) for _, sizes in candidates]
    best = int(np.argmax(ratios))
    if ratios[best] > LARGER:
        return *candidates[best], True
    upmost = _upmost([candidate for candidate, _ in candidates])
    return *next(pair for pair in candidates if pair[0] is upmost), False


def larger_dot_elsewhere(diameters: NDArray[np.float64]) -> bool:
    """Whether one of the two corners that cannot be the first has the larger dot."""
    return any(
        sizes[0, 0] / np.median([sizes[0, 1], sizes[1, 0], sizes[1, 1]]) > LARGER
        for sizes in (diameters[:, ::-1], diameters[::-1])
    )


def _turns(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The grid of numbers turned by half a turn, and by quarters where it is square."""
    step = 1 if numbers.shape[0] == numbers.shape[1] else 2
    return [np.rot90(numbers, quarters) for quarters in range(0, 4, step)]


def _same_colours(board: Board, turned: NDArray[np.int64]) -> bool:
    """Whether a checkerboard's first square, so numbered, is black as before."""
    # A square goes by its upper left corner, which has the lowest number.
    row, column = divmod(int(turned[:2, :2].min()), board.shape[0])
    return (row + column) % 2 == 0


def _first_is_black(grid: NDArray[np.float64], grey: NDArray[np.uint8]) -> bool:
    """Whether the squares that are black, so numbered, are darker than their neighbours."""
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    last = np.array(grey.shape[::-1]) - 1
    column, row = np.clip(np.round(middles), 0, last).astype(np.int64).transpose(2, 0, 1)
    values = grey[row, column].astype(np.float64)
    black = np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2 == 0
    return bool(values[black].mean() < values[~black].mean())


def _upmost(candidates: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The numbering whose first corner is most to the upper left: views taken alike mostly agree."""
    return min(candidates, key=lambda grid: float(grid[0, 0].sum()))
