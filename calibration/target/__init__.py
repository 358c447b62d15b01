"""Calibration boards: the sizes of a board and an image go in, the numbers and pixels of its corners come out.

`board` defines the boards, and `rendering` and `pdf` draw them. `detection` finds a board in an image with the help of
the other modules.
"""

from calibration.target.board import Board, BoardError, board_with_defaults
from calibration.target.corner_ordering import symmetric_numberings
from calibration.target.detection import BoardSighting, detect_board
from calibration.target.pdf import write_board_pdf
from calibration.target.rendering import BoardImage, render_board

__all__ = [
    "Board",
    "BoardError",
    "BoardImage",
    "BoardSighting",
    "board_with_defaults",
    "detect_board",
    "render_board",
    "symmetric_numberings",
    "write_board_pdf",
]
