"""`pointchain calibrate board`: a board to print."""

import sys
from pathlib import Path
from typing import Any

from calibration.board import Board, BoardError


def calibrate_board(out: Path, told: dict[str, Any], paper: str) -> int:
    """Writes the board with the fields `told` as PDF to `out`; 0 when that is done."""
    from calibration.board_print import write_board_pdf  # brings matplotlib along

    try:
        board = board_told(told)
        write_board_pdf(board, out, paper)
    except BoardError as error:
        print(f"pointchain calibrate board: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain calibrate board: {out} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    print(f"wrote {out}: {board}", file=sys.stderr)
    print("print it at 100 %, measure the line of 100 mm, and glue it flat to something stiff", file=sys.stderr)
    return 0


def board_told(told: dict[str, Any]) -> Board:
    """The usual board, but for what is told; markers in proportion to their squares. Raises BoardError."""
    if "pitch_m" in told and "marker_m" not in told:
        told = told | {"marker_m": told["pitch_m"] * Board.marker_m / Board.pitch_m}
    return Board(**told)
