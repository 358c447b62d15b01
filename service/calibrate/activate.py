"""`pointchain calibrate activate`: makes a solved calibration the one that the configured cell uses."""

import sys
from pathlib import Path

from calibration.errors import HandEyeError
from calibration.folder import HAND_EYE
from calibration.storage import HandEye, activate
from service.config import ConfigError, load_config


def calibrate_activate(solved: Path, config_file: Path | None) -> int:
    """Activates the file, or the `hand_eye.json` in the folder; 0 when that is done."""
    try:
        active_file = load_config(config_file).cell.hand_eye.active_file
        if active_file is None:
            raise ConfigError("no place is configured for the calibration in use: set hand_eye.file or data_dir")
        hand_eye = activate(solved / HAND_EYE if solved.is_dir() else solved, active_file)
    except (ConfigError, HandEyeError) as error:
        print(f"pointchain calibrate activate: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain calibrate activate: {_unwritten(error)}", file=sys.stderr)
        return 1
    print(activated(hand_eye, active_file), file=sys.stderr)
    return 0


def activated(hand_eye: HandEye, active_file: Path) -> str:
    """What was done, in words."""
    warned = "".join(f"; warning: {warning}" for warning in hand_eye.warnings)
    return f"active from now on: {active_file}{warned}"


def _unwritten(error: OSError) -> str:
    return f"{error.filename or 'the file'} cannot be written: {error.strerror or error}"
