"""The parser of `pointchain calibrate`. Each command imports its modules when it runs."""

import argparse
from pathlib import Path
from typing import Any

from service.cli.options import Commands, add_config_option, add_json_option, whole_number

BOARD_OPTIONS = ("kind", "columns", "rows", "pitch_m", "marker_m", "dictionary")
MIN_POSES, MAX_POSES = 10, 40
"""Limits of --poses. The minimum is that of `cell.planning.calibration_poses`, which is not imported for --help."""


def add_calibrate_commands(commands: Commands) -> None:
    """Add `calibrate` and its commands."""
    calibrate = commands.add_parser(
        "calibrate",
        help="make, verify and activate a hand-eye calibration",
        description="Make, verify and activate a hand-eye calibration: the pose of the camera in the flange frame.",
    )
    kinds = calibrate.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_board(kinds)
    _add_run(kinds)
    _add_verify(kinds)
    _add_solve(kinds)
    _add_activate(kinds)


def _add_board(kinds: Commands) -> None:
    board = kinds.add_parser(
        "board",
        help="write a board to print, as PDF",
        description="Write a calibration board as PDF, true to scale, with a line of 100 mm to measure on the print.",
    )
    board.add_argument("out", type=Path, metavar="OUT.pdf", help="file to write")
    board.add_argument("--paper", default="a4", choices=("a4", "a3", "letter"), help="size of the paper (%(default)s)")
    _add_board_options(board)
    board.set_defaults(run=_board)


def _add_run(kinds: Commands) -> None:
    run = kinds.add_parser(
        "run",
        help="calibrate the configured cell: the arm moves",
        description="Move the arm through poses from which the camera sees the board, which lies flat on the table in "
        "the middle of the workspace. Solve, verify on held-out poses, and ask whether to activate the result. Ctrl-C "
        "stops the arm. Exit code 1 if the result is refused.",
    )
    add_config_option(run)
    run.add_argument(
        "--poses",
        type=whole_number(MIN_POSES, MAX_POSES, "poses"),
        default=15,
        metavar="N",
        help="number of poses to solve from (%(default)s); 2 more are held out",
    )
    run.add_argument(
        "--folder", type=Path, metavar="DIR", help="new or empty folder for images and result (in the data folder)"
    )
    run.add_argument(
        "--yes", action="store_true", help="activate the result without asking, if it is verified and not refused"
    )
    add_json_option(run, "the result as one JSON document")
    _add_board_options(run)
    run.set_defaults(run=_run)


def _add_verify(kinds: Commands) -> None:
    verify = kinds.add_parser(
        "verify",
        help="verify the active calibration by two views of the board: the arm moves",
        description="Take two views of the board of the active calibration from different sides, and report whether "
        "the calibration still holds and whether the board was moved. Ctrl-C stops the arm. Exit code 1 if it does "
        "not hold.",
    )
    add_config_option(verify)
    verify.add_argument("--folder", type=Path, metavar="DIR", help="new or empty folder for the two images (not kept)")
    add_json_option(verify)
    verify.set_defaults(run=_verify)


def _add_solve(kinds: Commands) -> None:
    solve = kinds.add_parser(
        "solve",
        help="solve a calibration from images and poses in a folder",
        description="Solve from DIR/setup.json (board, camera) and, for each view, DIR/NAME.png and DIR/NAME.json "
        "(pose of the flange). Write observations.json and hand_eye.json there. Nothing moves. Exit code 1 if the "
        "result is refused.",
    )
    solve.add_argument("folder", type=Path, metavar="DIR", help="folder of a run, or of your own images")
    solve.add_argument("--again", action="store_true", help="solve from DIR/observations.json, without the images")
    solve.add_argument(
        "--out", type=Path, metavar="FILE", help="file for the result; observations.json is written beside it (in DIR)"
    )
    add_json_option(solve, "the result as one JSON document")
    solve.set_defaults(run=_solve)


def _add_activate(kinds: Commands) -> None:
    activate = kinds.add_parser(
        "activate",
        help="make a solved calibration the active one",
        description="Make a solved calibration the active one of the configured cell. The former one is kept beside "
        "it. Nothing moves.",
    )
    activate.add_argument("solved", type=Path, metavar="FILE|DIR", help="file of the calibration, or folder of its run")
    add_config_option(activate)
    activate.set_defaults(run=_activate)


def _add_board_options(parser: argparse.ArgumentParser) -> None:
    board = parser.add_argument_group("the board as printed")
    board.add_argument("--kind", choices=("charuco", "checkerboard", "circles"), help="kind of board (charuco)")
    board.add_argument("--columns", type=int, metavar="N", help="squares, or dots, in a row (9)")
    board.add_argument("--rows", type=int, metavar="N", help="rows of squares, or of dots (7)")
    board.add_argument(
        "--pitch",
        dest="pitch_m",
        type=float,
        metavar="M",
        help="side of a square, or distance of neighbouring dots (0.026)",
    )
    board.add_argument(
        "--marker",
        dest="marker_m",
        type=float,
        metavar="M",
        help="side of a ChArUco marker (0.02, in proportion to the pitch)",
    )
    board.add_argument("--dictionary", metavar="NAME", help="OpenCV dictionary of the ChArUco markers (DICT_4X4_50)")


def board_fields(options: argparse.Namespace) -> dict[str, Any]:
    """Return the given fields of `calibration.target.board.Board`."""
    return {name: value for name in BOARD_OPTIONS if (value := getattr(options, name)) is not None}


def _board(options: argparse.Namespace) -> int:
    from service.cli.calibrate.board import calibrate_board

    return calibrate_board(options.out, board_fields(options), options.paper)


def _run(options: argparse.Namespace) -> int:
    from service.cli.calibrate.run import CalibrationOptions, calibrate_run

    run_options = CalibrationOptions(board_fields(options), options.poses, options.folder, options.yes, options.json)
    return calibrate_run(options.config, run_options)


def _verify(options: argparse.Namespace) -> int:
    from service.cli.calibrate.verify import calibrate_verify

    return calibrate_verify(options.config, options.folder, options.json)


def _solve(options: argparse.Namespace) -> int:
    from service.cli.calibrate.solve import calibrate_solve

    return calibrate_solve(options.folder, options.again, options.out, options.json)


def _activate(options: argparse.Namespace) -> int:
    from service.cli.calibrate.activate import calibrate_activate

    return calibrate_activate(options.solved, options.config)
