"""The hand-eye calibration that a scan uses, and what refuses it."""

from calibration.errors import HandEyeError
from calibration.storage import HandEye, load_hand_eye, require_match
from cell.errors import CalibrationError
from cell.settings import HandEyeSettings
from cell.simulation.world import SimulatedWorld


def hand_eye_in_use(settings: HandEyeSettings, world: SimulatedWorld | None) -> HandEye:
    """The calibration of the configured file; without one, what is told of a simulated cell's `world`.

    Raises:
        CalibrationError: there is none, or the file cannot be used, or it is too old.
    """
    if settings.file is None:
        if world is None:
            raise CalibrationError("the configuration lacks hand_eye.file: calibrate, and name the file there")
        return world.told_hand_eye
    try:
        return load_hand_eye(settings.file, settings.max_age_days)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


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
