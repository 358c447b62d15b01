"""`pointchain calibrate board`: a board to print."""

import sys
from pathlib import Path
from typing import Any

from calibration.target.board import BoardError, board_with_defaults


def calibrate_board(out: Path, told: dict[str, Any], paper: str) -> int:
    """Writes the board with the fields `told` as PDF to `out`; 0 when that is done."""
    from calibration.target.pdf import write_board_pdf  # brings matplotlib along

    try:
        board = board_with_defaults(told)
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
