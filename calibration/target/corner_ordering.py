"""Choose the first corner of a checkerboard, or the first dot of a circle grid.

A symmetric board looks the same after a rotation. Two kinds of boards have a unique first corner:

- a checkerboard with an even number of squares along one side and an odd number along the other side;
- a circle grid with a larger first dot.

For a symmetric board, this module chooses one of the `symmetric_numberings`. Then
`calibration.pose_estimation.corner_disambiguation` makes the numberings of all views consistent. A mirrored image of a
symmetric board cannot be recognised as mirrored.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

MIN_LARGER_RATIO = 1.25
"""Minimum ratio of the diameter of a larger first dot to the diameter of its neighbours."""


def symmetric_numberings(board: Board) -> list[NDArray[np.int64]]:
    """Return all permutations of the corner numbers under which the board looks the same.

    A circle grid is treated as a grid of equal dots, because `Board` does not say whether the first dot is larger.

    Args:
        board: The board.

    Returns:
        Permutations `p`, each (N,): for a symmetric board, the corner numbers `ids` and `p[ids]` are equally possible.
        The first permutation is the identity. A ChArUco board has only the identity.
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
    """Reverse every row of a grid if its numbering is mirrored.

    On a board seen from the front, the y axis is a quarter turn clockwise from the x axis.

    Args:
        grid: (rows, columns, 2) pixels of the corners or dots.

    Returns:
        Right-handed grid (rows, columns, 2).
    """
    along_row = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    along_column = (grid[-1] - grid[0]).mean(axis=0)
    is_right_handed = along_row[0] * along_column[1] - along_row[1] * along_column[0] > 0
    return grid if is_right_handed else grid[:, ::-1]


def order_from_black_square(
    grid: NDArray[np.float64], grey: NDArray[np.uint8], board: Board
) -> tuple[NDArray[np.float64], bool]:
    """Rotate the numbering of a checkerboard so that its first square is black.

    Args:
        grid: (rows, columns, 2) pixels of the inner corners.
        grey: (H, W) grey image.
        board: The checkerboard.

    Returns:
        The rotated grid (rows, columns, 2), and whether the image determines the numbering.
    """
    pixels = grid.reshape(-1, 2)
    numbers = np.arange(len(pixels)).reshape(grid.shape[:2])
    candidates = [pixels[rotated] for rotated in _rotate_grid(numbers)]
    valid = [candidate for candidate in candidates if _is_first_square_black(candidate, grey)]
    is_unique = len(symmetric_numberings(board)) == 1 and len(valid) == 1
    possible = valid or candidates
    return possible[_most_upper_left(possible)], is_unique


def order_from_larger_dot(
    grid: NDArray[np.float64], diameters: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Rotate the numbering of a circle grid so that the larger dot is the first dot.

    Args:
        grid: (rows, columns, 2) pixels of the dots.
        diameters: (rows, columns) diameters of the dots, pixels.

    Returns:
        The rotated grid (rows, columns, 2), its diameters (rows, columns), and whether a larger first dot was found.
    """
    numbers = np.arange(diameters.size).reshape(diameters.shape)
    rotations = _rotate_grid(numbers)
    grids = [grid.reshape(-1, 2)[rotated] for rotated in rotations]
    grids_of_diameters = [diameters.ravel()[rotated] for rotated in rotations]
    # Compare each first dot with its neighbours only, because perspective makes near dots larger.
    ratios = [_first_dot_ratio(rotated) for rotated in grids_of_diameters]
    best = int(np.argmax(ratios))
    has_larger_dot = bool(ratios[best] > MIN_LARGER_RATIO)
    if not has_larger_dot:
        best = _most_upper_left(grids)
    return grids[best], grids_of_diameters[best], has_larger_dot


def is_larger_dot_misplaced(diameters: NDArray[np.float64]) -> bool:
    """Return whether the larger dot is at a corner that cannot be the first.

    Args:
        diameters: (rows, columns) diameters of the dots, pixels, as `order_from_larger_dot` returns them.
    """
    return any(_first_dot_ratio(flipped) > MIN_LARGER_RATIO for flipped in (diameters[:, ::-1], diameters[::-1]))


def _first_dot_ratio(diameters: NDArray[np.float64]) -> np.float64:
    """Return the diameter of the first dot divided by the median diameter of its three neighbours."""
    return diameters[0, 0] / np.median([diameters[0, 1], diameters[1, 0], diameters[1, 1]])


def _rotate_grid(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the rotations of a grid (rows, columns) that keep its shape: by half turns, or quarter turns if square."""
    rows, columns = numbers.shape
    step = 1 if rows == columns else 2
    return [np.rot90(numbers, quarters) for quarters in range(0, 4, step)]


def _keeps_colours(board: Board, rotated: NDArray[np.int64]) -> bool:
    """Return whether the first inner square is black after the rotation of the corner numbers (rows, columns)."""
    # The lowest corner number of a square gives its row and column before the rotation.
    row, column = divmod(int(rotated[:2, :2].min()), board.shape[0])
    return (row + column) % 2 == 0


def _is_first_square_black(grid: NDArray[np.float64], grey: NDArray[np.uint8]) -> bool:
    """Return whether the squares coloured like the first square of `grid` (rows, columns, 2) are darker on average."""
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    last = np.array(grey.shape[::-1]) - 1
    column, row = np.clip(np.round(centres), 0, last).astype(np.int64).transpose(2, 0, 1)
    values = grey[row, column].astype(np.float64)
    is_black = np.add.outer(np.arange(values.shape[0]), np.arange(values.shape[1])) % 2 == 0
    return bool(values[is_black].mean() < values[~is_black].mean())


def _most_upper_left(grids: list[NDArray[np.float64]]) -> int:
    """Return the index of the grid with the most upper left first corner. Similar views get the same numbering."""
    return int(np.argmin([grid[0, 0].sum() for grid in grids]))
