"""`pointchain calibrate run`: take the images, solve, verify, and ask whether to activate the result."""

import json
import sys
import threading
import time
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from calibration.dataset.folder import HAND_EYE_FILE, SETUP_FILE
from calibration.errors import HandEyeError
from calibration.storage.hand_eye_file import activate
from calibration.target.board import Board, BoardError, board_with_defaults
from cell.config.cell_config import CellSettings
from cell.control.calibration_run import CalibrationRun, run_calibration
from cell.control.cell import Cell
from cell.planning.calibration_poses import HELD_OUT, POSES
from service.cli.calibrate.activate import activation_command, activation_message
from service.cli.calibrate.report import format_result, format_verification
from service.cli.output_folder import create_output_folder
from service.cli.progress import TerminalProgress
from service.cli.prompt import confirm
from service.cli.robot_task import EndedEarlyError, run_with_cell
from service.config.loader import ConfigError, load_config
from service.problems.document import error_document

Activation = Literal["active", "not active", "failed"]
"""Whether a result was activated. `failed`: it should have been activated and could not be."""


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of one calibration run."""

    board: dict[str, Any] = field(default_factory=dict)
    """Given fields of the board. The others have their defaults."""
    poses: int = POSES
    """Number of poses to solve from."""
    folder: Path | None = None
    """Folder for images and result. None: a new one in the folder of the cell's calibrations."""
    yes: bool = False
    """Activate the result without asking, if it is verified."""
    as_json: bool = False
    """Print the result as JSON."""


def calibrate_run(config_file: Path | None, options: CalibrationOptions) -> int:
    """Calibrate the configured cell, and print the result to stdout.

    Args:
        config_file: Configuration of the cell. None: the default one.
        options: Options of the run.

    Returns:
        The exit code: 0 if the result may be used; 1 if it is refused, if there is none, or if its activation failed;
        130 after a signal, which stops the arm.
    """
    try:
        board = board_with_defaults(options.board)
        settings = load_config(config_file).cell
        folder = options.folder or _new_folder(settings)
        create_output_folder(folder)
    except (ConfigError, BoardError) as error:
        return _fail(error_document(error.slug, str(error)), 1, options.as_json)
    _report(_start_message(settings, board, options.poses))

    def task(cell: Cell, stop_requested: threading.Event) -> CalibrationRun:
        return _calibrate(cell, stop_requested, board, options.poses, folder)

    try:
        run = run_with_cell(settings, task, folder)
    except EndedEarlyError as error:
        if (folder / SETUP_FILE).exists():
            error.problem["detail"] += (
                f"; the images taken until then are in {folder}; if there are enough, solve them: "
                f"pointchain calibrate solve {folder}"
            )
        return _fail(error.problem, error.code, options.as_json)
    if not options.as_json:
        print(format_result(run.result, run.unused))
        print(format_verification(run.verification), flush=True)  # before the question on stderr
    _report(f"images and result are in {folder}")
    activation = _activate(run, settings, folder, options.yes, activation_command(folder, config_file))
    if options.as_json:
        document = json.loads((folder / HAND_EYE_FILE).read_bytes())
        document |= {
            "unseen": [{"name": name, "reason": reason} for name, reason in run.unused],
            "folder": str(folder),
            "activated": activation == "active",
        }
        print(json.dumps(document, allow_nan=False), flush=True)
    return 1 if run.result.verdict == "refuse" or activation == "failed" else 0


def _calibrate(cell: Cell, stop_requested: threading.Event, board: Board, poses: int, folder: Path) -> CalibrationRun:
    _report("connecting, planning")
    prepared = cell.prepare_calibration(board, time.monotonic(), poses, HELD_OUT)
    plan = prepared.plan
    _report(f"{plan.reachable} of {len(plan.viewpoints)} poses can be reached")
    for warning in plan.warnings:
        _report(warning)
    return run_calibration(cell, prepared, folder, TerminalProgress(prepared, _report, stop_requested))


def _activate(run: CalibrationRun, settings: CellSettings, folder: Path, yes: bool, command: str) -> Activation:
    """Ask whether to activate the result, and activate it. With `yes`, only a verified result is activated, unasked."""
    if run.result.verdict == "refuse":
        _report("the result is refused; the active calibration is unchanged")
        return "not active"
    active_file = settings.hand_eye.active_file
    if active_file is None:
        _report(f"the result is not active: set hand_eye.file to {folder / HAND_EYE_FILE}")
        return "not active"
    how_to = f"to activate it: {command}"
    verified = bool(run.verification.views)
    if yes and not verified:
        _report(f"the result is not verified, so --yes does not activate it; {how_to}")
        return "not active"
    caution = "" if verified else "unverified "
    if not yes and not confirm(f"activate this {caution}calibration as {active_file}?"):
        _report(f"the result is not active; {how_to}")
        return "not active"
    try:
        hand_eye = activate(folder / HAND_EYE_FILE, active_file)
    except HandEyeError as error:
        _report(f"the result cannot be activated: {error}")
        return "failed"
    except OSError as error:
        _report(f"{active_file} cannot be written: {error.strerror or error}; the result is not active")
        return "failed"
    _report(activation_message(hand_eye, active_file))
    return "active"


def _new_folder(settings: CellSettings) -> Path:
    """Return a folder for this run, named by the time.

    Raises:
        ConfigError: No folder is configured for calibrations.
    """
    calibrations = settings.hand_eye.folder
    if calibrations is None:
        raise ConfigError("no folder is configured for calibrations: set data_dir, or give a folder by --folder")
    return calibrations / "runs" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def _start_message(settings: CellSettings, board: Board, poses: int) -> str:
    (x0, x1), (y0, y1), (z, _) = settings.workspace_m
    centre = f"x {(x0 + x1) / 2:.3f}, y {(y0 + y1) / 2:.3f}, z {z:.3f} m"
    return (
        f"the arm will move through {poses + HELD_OUT} poses; the board ({board}) must lie flat on the table in the "
        f"middle of the workspace ({centre}) and stay there; Ctrl-C stops the arm"
    )


def _fail(problem: dict[str, Any], code: int, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}), flush=True)
    _report(problem["detail"])
    return code


def _report(message: str) -> None:
    print(f"pointchain calibrate run: {message}", file=sys.stderr)
