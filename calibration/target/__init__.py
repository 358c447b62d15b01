"""Calibration boards: a board description and an image go in, the numbers and pixels of the corners come out.

`board` describes boards, `rendering` and `pdf` draw boards, and `detection` detects a board in an image. The other
modules are steps of the detection.
"""

from calibration.target.board import Board, BoardError, board_with_defaults
from calibration.target.corner_ordering import symmetric_numberings
from calibration.target.detection import DetectedBoard, detect_board
from calibration.target.pdf import write_board_pdf
from calibration.target.rendering import BoardImage, render_board

__all__ = [
    "Board",
    "BoardError",
    "BoardImage",
    "DetectedBoard",
    "board_with_defaults",
    "detect_board",
    "render_board",
    "symmetric_numberings",
    "write_board_pdf",
]
