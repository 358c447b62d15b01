"""`pointchain calibrate verify`: two looks at the board, and whether the calibration in use still holds."""

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
from service.cli.calibrate.progress import ToldCalibration
from service.cli.calibrate.report import verification_words
from service.cli.output_folder import require_new_folder
from service.cli.robot_task import EndedEarlyError, with_moving_cell
from service.config.loader import ConfigError, load_config
from service.problems.document import error_document


def calibrate_verify(config_file: Path | None, folder: Path | None, as_json: bool) -> int:
    """Verifies the calibration in use; 0 when it holds, 1 when not or nobody knows, 130 after a signal.

    The pictures are kept in `folder`, a new or empty one, if one is named.
    """
    try:
        settings = load_config(config_file).cell
        if folder is not None:
            require_new_folder(folder)
        with TemporaryDirectory(prefix="pointchain-") as passing:
            pictures = folder or Path(passing) / "verification"
            found = with_moving_cell(settings, lambda cell, stop: _verified(cell, stop, pictures), pictures)
    except ConfigError as error:
        return _failed(error_document(error.slug, str(error)), 1, as_json)
    except OSError as error:
        where = f"{error.filename or 'the folder for the pictures'} cannot be written: {error.strerror or error}"
        return _failed(error_document("file", where), 1, as_json)
    except EndedEarlyError as error:
        return _failed(error.problem, error.code, as_json)
    print(json.dumps(found.to_json(), allow_nan=False) if as_json else verification_words(found), flush=True)
    return 0 if found.passed else 1


def _verified(cell: Cell, stop_asked: threading.Event, folder: Path) -> Verification:
    _say("the arm will move to two poses; the board must lie on the table; Ctrl-C stops the arm")
    _say("connecting, planning")
    prepared = cell.prepare_verification(time.monotonic())
    found = run_verification(cell, prepared, folder, ToldCalibration(prepared.plan, stop_asked, "verify"))
    try:
        cell.hand_eye()
    except CellError as error:  # as for its age, which makes it no worse for this
        _say(f"whatever the verification says, no scan uses it: {error}")
    return found


def _failed(problem: dict[str, object], code: int, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}), flush=True)
    _say(str(problem["detail"]))
    return code


def _say(words: str) -> None:
    print(f"pointchain calibrate verify: {words}", file=sys.stderr)
