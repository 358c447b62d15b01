"""`pointchain calibrate verify`: take two views of the board, and report whether the active calibration still holds."""

import json
import sys
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from calibration.verification.verification import Verification
from cell.control.calibration_run import run_verification
from cell.control.cell import Cell
from cell.errors import CellError
from service.cli.calibrate.report import format_verification
from service.cli.output_folder import create_output_folder
from service.cli.progress import TerminalProgress
from service.cli.robot_task import EndedEarlyError, run_with_cell
from service.config.loader import ConfigError, load_config
from service.problems.document import error_document


def calibrate_verify(config_file: Path | None, folder: Path | None, as_json: bool) -> int:
    """Verify the active calibration, and print the verification to stdout.

    Args:
        config_file: Configuration of the cell. None: the default one.
        folder: New or empty folder for the images. None: they are not kept.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if the calibration holds; 1 if it does not, or if the verification failed; 130 after a signal.
    """
    try:
        settings = load_config(config_file).cell
        if folder is not None:
            create_output_folder(folder)
        with TemporaryDirectory(prefix="pointchain-") as temporary:
            images = folder or Path(temporary) / "verification"
            verification = run_with_cell(settings, lambda cell, stop: _verify(cell, stop, images), images)
    except ConfigError as error:
        return _fail(error_document(error.slug, str(error)), 1, as_json)
    except OSError as error:
        where = f"{error.filename or 'the folder for the images'} cannot be written: {error.strerror or error}"
        return _fail(error_document("file", where), 1, as_json)
    except EndedEarlyError as error:
        return _fail(error.problem, error.code, as_json)
    output = json.dumps(verification.to_json(), allow_nan=False) if as_json else format_verification(verification)
    print(output, flush=True)
    return 0 if verification.passed else 1


def _verify(cell: Cell, stop_requested: threading.Event, folder: Path) -> Verification:
    _report("the arm will move to two poses; the board must lie on the table; Ctrl-C stops the arm")
    _report("connecting, planning")
    prepared = cell.prepare_verification(time.monotonic())
    verification = run_verification(cell, prepared, folder, TerminalProgress(prepared, _report, stop_requested))
    try:
        cell.hand_eye()
    except CellError as error:  # a calibration that is too old can be verified, but not used
        _report(f"no scan uses this calibration, whatever the verification says: {error}")
    return verification


def _fail(problem: dict[str, object], code: int, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}), flush=True)
    _report(str(problem["detail"]))
    return code


def _report(message: str) -> None:
    print(f"pointchain calibrate verify: {message}", file=sys.stderr)
