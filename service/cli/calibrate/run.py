"""`pointchain calibrate run`: plan, move, see, solve, verify, and ask before the result is used."""

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
from service.cli.calibrate.activate import activated, activation_command
from service.cli.calibrate.progress import ToldCalibration
from service.cli.calibrate.report import result_words, verification_words
from service.cli.output_folder import require_new_folder
from service.cli.prompt import agreed
from service.cli.robot_task import EndedEarlyError, with_moving_cell
from service.config.loader import ConfigError, load_config
from service.problems.document import error_document

Use = Literal["active", "unused", "failed"]
"""Of a result: the calibration in use; not, as somebody wanted it; not, though somebody wanted it."""


@dataclass(frozen=True)
class WantedRun:
    """A calibration as somebody asks for it."""

    board: dict[str, Any] = field(default_factory=dict)
    """What was told of the board."""
    poses: int = POSES
    folder: Path | None = None
    """Where images and result go; None: where the cell keeps its calibrations."""
    yes: bool = False
    """Use the result without asking; not one that was not verified."""
    as_json: bool = False


def calibrate_run(config_file: Path | None, wanted: WantedRun) -> int:
    """Calibrates the configured cell; the result as words, or JSON, on stdout.

    0 when it may be used, 1 when it is refused, there is none, or it was to be used and could not be put in use; 130
    after a signal, which stops the arm.
    """
    try:
        board = board_with_defaults(wanted.board)
        settings = load_config(config_file).cell
        folder = wanted.folder or _new_folder(settings)
        require_new_folder(folder)
    except (ConfigError, BoardError) as error:
        return _failed(error_document(error.slug, str(error)), 1, wanted.as_json)
    _say(_announced(settings, board, wanted.poses))

    def do(cell: Cell, stop_asked: threading.Event) -> CalibrationRun:
        return _calibrated(cell, stop_asked, board, wanted.poses, folder)

    try:
        run = with_moving_cell(settings, do, folder)
    except EndedEarlyError as error:
        if (folder / SETUP_FILE).exists():
            error.problem["detail"] += (
                f"; what was taken until then is in {folder}, and where it is enough, this solves it: "
                f"pointchain calibrate solve {folder}"
            )
        return _failed(error.problem, error.code, wanted.as_json)
    if not wanted.as_json:
        print(result_words(run.result, run.unused))
        print(verification_words(run.verification), flush=True)  # before anything is asked
    _say(f"images and result are in {folder}")
    use = _asked_and_activated(run, settings, folder, wanted.yes, activation_command(folder, config_file))
    if wanted.as_json:
        document = json.loads((folder / HAND_EYE_FILE).read_bytes())
        document |= {
            "unseen": [{"name": name, "reason": reason} for name, reason in run.unused],
            "folder": str(folder),
            "activated": use == "active",
        }
        print(json.dumps(document, allow_nan=False), flush=True)
    return 1 if run.result.verdict == "refuse" or use == "failed" else 0


def _calibrated(cell: Cell, stop_asked: threading.Event, board: Board, poses: int, folder: Path) -> CalibrationRun:
    _say("connecting, planning")
    prepared = cell.prepare_calibration(board, time.monotonic(), poses, HELD_OUT)
    plan = prepared.plan
    told = ToldCalibration(plan, stop_asked, "run")
    told.say(f"{plan.reached} of {len(plan.viewpoints)} poses can be reached")
    for warning in plan.warnings:
        told.say(warning)
    return run_calibration(cell, prepared, folder, told)


def _asked_and_activated(run: CalibrationRun, settings: CellSettings, folder: Path, yes: bool, command: str) -> Use:
    """Ask whether to activate the result, and do so; `--yes` alone does not activate a result that is not verified."""
    if run.result.verdict == "refuse":
        _say("it is refused, and what was in use stays in use")
        return "unused"
    active_file = settings.hand_eye.active_file
    if active_file is None:
        _say(f"it is not in use: name {folder / HAND_EYE_FILE} in hand_eye.file")
        return "unused"
    by_hand = f"to use it: {command}"
    verified = bool(run.verification.views)
    if yes and not verified:
        _say(f"it is not verified, and so not in use without somebody who decides it; {by_hand}")
        return "unused"
    doubt = "" if verified else ", though it is not verified"
    if not yes and not agreed(f"use it from now on{doubt}, as {active_file}?"):
        _say(f"it is not in use; {by_hand}")
        return "unused"
    try:
        hand_eye = activate(folder / HAND_EYE_FILE, active_file)
    except HandEyeError as error:
        _say(f"it cannot be used: {error}")
        return "failed"
    except OSError as error:
        _say(f"{active_file} cannot be written: {error.strerror or error}; it is not in use")
        return "failed"
    _say(activated(hand_eye, active_file))
    return "active"


def _new_folder(settings: CellSettings) -> Path:
    """A folder of its own for this run, named by the time. Raises ConfigError."""
    kept = settings.hand_eye.folder
    if kept is None:
        raise ConfigError("no folder is configured for calibrations: set data_dir, or name one by --folder")
    return kept / "runs" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def _announced(settings: CellSettings, board: Board, poses: int) -> str:
    (x0, x1), (y0, y1), (z, _) = settings.workspace_m
    place = f"x {(x0 + x1) / 2:.3f}, y {(y0 + y1) / 2:.3f}, z {z:.3f} m"
    return (
        f"the arm will move through {poses + HELD_OUT} poses; the board ({board}) must lie flat on the table about the "
        f"workspace's middle ({place}) and stay there; Ctrl-C stops the arm"
    )


def _failed(problem: dict[str, Any], code: int, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}), flush=True)
    _say(problem["detail"])
    return code


def _say(words: str) -> None:
    print(f"pointchain calibrate run: {words}", file=sys.stderr)
