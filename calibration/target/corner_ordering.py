"""Decide which corner of a checkerboard, or dot of a circle grid, is the first.

A plain grid looks the same from more than one side. Two boards do not: a checkerboard with an even number of squares
along one side and an odd number along the other, because of the colours, and a circle grid whose first dot is larger.
For the other boards one of the numberings of `symmetric_numberings` is chosen, and
`calibration.pose_estimation.corner_disambiguation` makes views agree. A mirrored image of a plain grid looks like an
image of another plain grid, and is not detected.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

MIN_LARGER_RATIO = 1.25
"""Minimum diameter of the larger first dot, relative to the dots around it."""


def symmetric_numberings(board: Board) -> list[NDArray[np.int64]]:
    """Return all permutations of the corner numbers under which the board looks the same.

    A circle grid is assumed to have no larger first dot. If a view shows one (`BoardSighting.is_numbering_unique`), its
    numbering is known and needs no permutation.

    Args:
        board: The board.

    Returns:
        Permutations `p` (N,): the numbers `ids` of a view may as well be `p[ids]`. The first is the identity, which is
        the only one of a ChArUco board.
    """
    columns, rows = board.shape
    numbers = np.arange(columns * rows).reshape(rows, columns)
    if board.kind == "charuco":
        return [numbers.ravel()]
    return [
        rotated.ravel()
        for rotated in _rotate_grid(numbers)
        if board.kind == "circles" or _keeps_colours(board, rotated)
    ]


def make_right_handed(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pixels (rows, columns, 2) of a grid with each row reversed if the numbering is mirrored.

    Seen from the front, y is a quarter turn clockwise from x.
    """
    (xx, xy), (yx, yy) = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    return grid if xx * yy - xy * yx > 0 else grid[:, ::-1]


def order_from_black_square(
    grid: NDArray[np.float64], grey: NDArray[np.uint8], board: Board
) -> tuple[NDArray[np.float64], bool]:
    """Rotate the numbering of a checkerboard so that its first square is black.

    Args:
        grid: (rows, columns, 2) pixels of the inner corners.
        grey: (H, W) grey image.
        board: The checkerboard.

    Returns:
        The rotated grid (rows, columns, 2), and whether it is the only possible numbering.
    """
    numbers = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
    candidates = [grid.reshape(-1, 2)[rotated] for rotated in _rotate_grid(numbers)]
    valid = [candidate for candidate in candidates if _is_first_square_black(candidate, grey)]
    return _choose_upper_left(valid or candidates), len(symmetric_numberings(board)) == 1 and len(valid) == 1


def order_from_larger_dot(
    grid: NDArray[np.float64], diameters: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Rotate the numbering of a circle grid so that its larger dot is the first.

    Args:
        grid: (rows, columns, 2) pixels of the dots.
        diameters: (rows, columns) diameters of the dots, pixels.

    Returns:
        The rotated grid (rows, columns, 2), its diameters (rows, columns), and whether a larger dot was found at a
        corner where a grid of this shape can begin.
    """
    numbers = np.arange(diameters.size).reshape(diameters.shape)
    candidates = [(grid.reshape(-1, 2)[rotated], diameters.ravel()[rotated]) for rotated in _rotate_grid(numbers)]
    # Relative to the neighbours, because perspective makes near dots larger.
    ratios = [_first_dot_ratio(rotated) for _, rotated in candidates]
    best = int(np.argmax(ratios))
    if ratios[best] > MIN_LARGER_RATIO:
        return *candidates[best], True
    chosen = _choose_upper_left([candidate for candidate, _ in candidates])
    return *next(pair for pair in candidates if pair[0] is chosen), False


def is_larger_dot_misplaced(diameters: NDArray[np.float64]) -> bool:
    """Return whether the larger dot is at a corner that cannot be the first, given all diameters (rows, columns)."""
    return any(_first_dot_ratio(flipped) > MIN_LARGER_RATIO for flipped in (diameters[:, ::-1], diameters[::-1]))


def _first_dot_ratio(diameters: NDArray[np.float64]) -> np.float64:
    """Return the diameter of the first dot relative to its three neighbours."""
    return diameters[0, 0] / np.median([diameters[0, 1], diameters[1, 0], diameters[1, 1]])


def _rotate_grid(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the grid of numbers and its rotations: by half a turn, or by quarter turns if it is square."""
    step = 1 if numbers.shape[0] == numbers.shape[1] else 2
    return [np.rot90(numbers, quarters) for quarters in range(0, 4, step)]


def _keeps_colours(board: Board, rotated: NDArray[np.int64]) -> bool:
    """Return whether the first square of a checkerboard with the rotated numbering is still black."""
    # A square is identified by its upper left corner, which has the lowest number.
    row, column = divmod(int(rotated[:2, :2].min()), board.shape[0])
    return (row + column) % 2 == 0


def _is_first_square_black(grid: NDArray[np.float64], grey: NDArray[np.uint8]) -> bool:
    """Return whether the squares that this numbering makes black are darker than the others."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    last = np.array(grey.shape[::-1]) - 1
    column, row = np.clip(np.round(centres), 0, last).astype(np.int64).transpose(2, 0, 1)
    values = grey[row, column].astype(np.float64)
    is_black = np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2 == 0
    return bool(values[is_black].mean() < values[~is_black].mean())


def _choose_upper_left(candidates: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the numbering whose first corner is nearest to the upper left, so that similar views mostly agree."""
    return min(candidates, key=lambda grid: float(grid[0, 0].sum()))
