"""`pointchain calibrate activate`: make a solved calibration the active one of the configured cell."""

import shlex
import sys
from pathlib import Path

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.errors import HandEyeError, HandEyeMismatchError
from calibration.storage.hand_eye_file import HandEye, activate
from service.config.loader import ConfigError, load_config


def calibrate_activate(solved: Path, config_file: Path | None) -> int:
    """Activate a solved calibration.

    Args:
        solved: Hand-eye file, or folder with a `hand_eye.json`.
        config_file: Configuration of the cell. None: the default one.

    Returns:
        The exit code: 0 if the calibration is active, else 1.
    """
    try:
        cell = load_config(config_file).cell
        active_file = cell.hand_eye.active_file
        if active_file is None:
            raise ConfigError("no file is configured for the active calibration: set hand_eye.file or data_dir")
        run_file = solved / HAND_EYE_FILE if solved.is_dir() else solved
        hand_eye = activate(run_file, active_file, cell.camera_id, cell.robot_serial)
    except HandEyeMismatchError as error:
        advice = "or give the configuration of its own cell by --config"
        print(f"pointchain calibrate activate: {error}; {advice}", file=sys.stderr)
        return 1
    except (ConfigError, HandEyeError) as error:
        print(f"pointchain calibrate activate: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        where = error.filename or "the file"
        print(f"pointchain calibrate activate: {where} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    print(activation_message(hand_eye, active_file), file=sys.stderr)
    return 0


def activation_command(solved: Path, config_file: Path | None) -> str:
    """Return the command line that activates a result in the cell of this configuration file."""
    config = [] if config_file is None else ["--config", str(config_file)]
    return shlex.join(["pointchain", "calibrate", "activate", str(solved), *config])


def activation_message(hand_eye: HandEye, active_file: Path) -> str:
    """Return the message about an activation, with the warnings about the calibration."""
    warnings = "".join(f"; warning: {warning}" for warning in hand_eye.warnings)
    return f"active calibration: {active_file}{warnings}"
