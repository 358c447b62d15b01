"""`pointchain calibrate board`: write a board to print."""

import sys
from pathlib import Path
from typing import Any

from calibration.target.board import BoardError, board_with_defaults


def calibrate_board(out: Path, given: dict[str, Any], paper: str) -> int:
    """Write a board as PDF.

    Args:
        out: File to write.
        given: Fields of the board that the caller gives. The others have their defaults.
        paper: Size of the paper.

    Returns:
        The exit code: 0 if the file was written, else 1.
    """
    from calibration.target.pdf import write_board_pdf  # imports matplotlib

    try:
        board = board_with_defaults(given)
        write_board_pdf(board, out, paper)
    except BoardError as error:
        print(f"pointchain calibrate board: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain calibrate board: {out} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    print(f"wrote {out}: {board}", file=sys.stderr)
    print("print it at 100 %, measure the line of 100 mm, and glue the print flat to a stiff plate", file=sys.stderr)
    return 0
