"""The hand-eye calibration that a scan uses, and what refuses it; and the rough one that a calibration begins with."""

import hashlib
from pathlib import Path

import numpy as np

from calibration.errors import HandEyeError
from calibration.storage import HandEye, load_hand_eye, require_match
from calibration.transforms import from_rotation_vector
from cell.errors import CalibrationError
from cell.settings import HandEyeSettings
from cell.simulation.world import SimulatedWorld

MAKE_ONE = "calibrate the cell with `pointchain calibrate run`, or name the file of a calibration in hand_eye.file"


def hand_eye_in_use(settings: HandEyeSettings, world: SimulatedWorld | None) -> HandEye:
    """The calibration of the active file; where there is none yet, what is told of a simulated cell's `world`.

    Raises:
        CalibrationError: there is none, or the file cannot be used, or it is too old.
    """
    file = file_in_use(settings)
    if file is None:
        if world is not None:
            return world.told_hand_eye
        where = "" if settings.active_file is None else f" {settings.active_file}"
        raise CalibrationError(f"there is no hand-eye calibration{where} yet: {MAKE_ONE}")
    try:
        return load_hand_eye(file, settings.max_age_days)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def file_in_use(settings: HandEyeSettings) -> Path | None:
    """The active file; None where no file is configured and none was made yet."""
    file = settings.active_file
    return None if file is None or (settings.file is None and not file.exists()) else file


def rough_hand_eye(settings: HandEyeSettings, world: SimulatedWorld | None) -> HandEye:
    """About where the camera is: by the active file, however old; else by a ruler; else by a simulated cell's `world`.

    Whose camera and robot the file is of does not matter.

    Raises:
        CalibrationError: nothing is known of it.
    """
    file, why = file_in_use(settings), ""
    if file is not None:
        try:
            return load_hand_eye(file, np.inf)
        except HandEyeError as error:
            why = f" ({error})"
    if settings.rough_xyz_m is not None:
        T = from_rotation_vector(settings.rough_xyz_m, settings.rough_rotation_rad)
        return HandEye(T, None, None, None, hashlib.sha256(T.tobytes()).hexdigest())
    if world is not None:
        return world.told_hand_eye
    raise CalibrationError(
        f"a first calibration needs to know roughly where the camera is{why}: measure with a ruler from the middle of "
        "the flange to the lens along the flange's x, y and z, to 3 cm, and give it in metres as hand_eye.rough_xyz_m "
        "= [x, y, z]; where the camera does not look along the flange's z with its x along the flange's, also "
        "hand_eye.rough_rotation_rad, its rotation vector"
    )


def verifiable_hand_eye(settings: HandEyeSettings) -> HandEye:
    """The calibration of the active file, however old, that tells of its board: by looking there it can be verified.

    Raises:
        CalibrationError: there is none, or it does not tell with which board it was made, where that lay, and how sure
            it is.
    """
    file = file_in_use(settings)
    if file is None:
        raise CalibrationError(f"there is no hand-eye calibration to verify yet: {MAKE_ONE}")
    try:
        hand_eye = load_hand_eye(file, np.inf)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error
    if any(told is None for told in (hand_eye.board, hand_eye.T_base_board, hand_eye.covariance, hand_eye.K)):
        raise CalibrationError(
            f"{file} does not tell with which board it was calibrated and where that lay, so that it cannot be "
            "verified: calibrate the cell with `pointchain calibrate run`"
        )
    return hand_eye


def require_its_own(hand_eye: HandEye, camera_id: str, robot_serial: str) -> None:
    """Refuses the calibration of another camera or robot. Raises CalibrationError."""
    try:
        require_match(hand_eye, camera_id, robot_serial)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def require_unchanged(used: HandEye, now: HandEye) -> None:
    """Refuses to go on when the calibration is not that of the scan's beginning. Raises CalibrationError."""
    if now.sha256 != used.sha256:
        raise CalibrationError(
            "the hand-eye calibration was changed during the scan: its views would not fit together. Scan again"
        )
