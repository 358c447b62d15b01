"""`pointchain calibrate activate`: makes a solved calibration the one that the configured cell uses."""

import shlex
import sys
from pathlib import Path

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.errors import HandEyeError, HandEyeMismatchError
from calibration.storage.hand_eye_file import HandEye, activate
from service.config.loader import ConfigError, load_config


def calibrate_activate(solved: Path, config_file: Path | None) -> int:
    """Activates the file, or the `hand_eye.json` in the folder; 0 when that is done."""
    try:
        cell = load_config(config_file).cell
        active_file = cell.hand_eye.active_file
        if active_file is None:
            raise ConfigError("no place is configured for the calibration in use: set hand_eye.file or data_dir")
        run_file = solved / HAND_EYE_FILE if solved.is_dir() else solved
        hand_eye = activate(run_file, active_file, cell.camera_id, cell.robot_serial)
    except HandEyeMismatchError as error:
        advice = "or name the configuration of its own cell with --config"
        print(f"pointchain calibrate activate: {error}; {advice}", file=sys.stderr)
        return 1
    except (ConfigError, HandEyeError) as error:
        print(f"pointchain calibrate activate: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain calibrate activate: {_unwritten(error)}", file=sys.stderr)
        return 1
    print(activated(hand_eye, active_file), file=sys.stderr)
    return 0


def activation_command(solved: Path, config_file: Path | None) -> str:
    """Return the command line that activates a result in the cell of this configuration file."""
    config = [] if config_file is None else ["--config", str(config_file)]
    return shlex.join(["pointchain", "calibrate", "activate", str(solved), *config])


def activated(hand_eye: HandEye, active_file: Path) -> str:
    """What was done, in words."""
    warned = "".join(f"; warning: {warning}" for warning in hand_eye.warnings)
    return f"active from now on: {active_file}{warned}"


def _unwritten(error: OSError) -> str:
    return f"{error.filename or 'the file'} cannot be written: {error.strerror or error}"
