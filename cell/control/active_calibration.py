"""The hand-eye calibration that a scan uses, and the initial guess of a new calibration."""

import hashlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from calibration.errors import HandEyeError
from calibration.geometry.transforms import from_rotation_vector, inverse, rotation_angle
from calibration.storage.hand_eye_file import HandEye, load_hand_eye, require_match
from cell.config.cell_config import HandEyeSettings
from cell.control.prepared import Prepared, PreparedScan, PreparedVerification
from cell.errors import CalibrationError

CALIBRATE = "calibrate the cell with `pointchain calibrate run`, or name the file of a calibration in hand_eye.file"

RULER_M, RULER_RAD = 0.03, np.deg2rad(10.0)
"""Required accuracy of a measurement with a ruler. A file that differs by more is of another mounting."""


def hand_eye_in_use(settings: HandEyeSettings, nominal: HandEye | None, moment: datetime | None = None) -> HandEye:
    """Load the active calibration.

    Args:
        settings: Active file and maximum age.
        nominal: Calibration of a simulated cell, used as long as no file exists. None for a real cell.
        moment: Time at which the age is checked. None means now.

    Raises:
        CalibrationError: There is no calibration, it cannot be used, or it is too old.
    """
    file = file_in_use(settings)
    if file is None:
        if nominal is not None:
            return nominal
        where = "" if settings.active_file is None else f" {settings.active_file}"
        raise CalibrationError(f"there is no hand-eye calibration{where} yet: {CALIBRATE}")
    try:
        return load_hand_eye(file, settings.max_age_days, moment)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def file_in_use(settings: HandEyeSettings) -> Path | None:
    """Return the active file, or None where no file is configured and no calibration was made yet."""
    file = settings.active_file
    return None if file is None or (settings.file is None and not file.exists()) else file


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """Sources of the approximate pose of the camera on the flange. At least one of them is not None."""

    from_file: HandEye | None
    """Calibration of the active file, of any age."""
    from_ruler: HandEye | None
    """Measurement with a ruler, as configured."""
    nominal: HandEye | None
    """Calibration of a simulated cell."""
    file_error: str = ""
    """Why the active file is not used, in brackets, or an empty text."""

    def choose(self, camera_id: str | None, robot_serial: str | None) -> HandEye:
        """Return the best source for this camera and robot: the file, then the ruler, then the simulated cell.

        Raises:
            CalibrationError: The file is of another camera or robot and there is no other source, or the measurement
                contradicts the file.
        """
        file, file_error = self.from_file, self.file_error
        if file is not None:
            try:
                require_match(file, camera_id, robot_serial)
            except HandEyeError as error:
                file, file_error = None, f" ({error})"
        if file is not None:
            if self.from_ruler is not None:
                _require_agreement(file, self.from_ruler)
            return file
        other = self.from_ruler or self.nominal
        if other is None:
            raise _no_guess_error(file_error)
        return other


def initial_guess(settings: HandEyeSettings, nominal: HandEye | None) -> InitialGuess:
    """Collect what is known of the camera's mounting before a calibration. No device is queried.

    Args:
        settings: Active file and measurement with a ruler.
        nominal: Calibration of a simulated cell, or None.

    Raises:
        CalibrationError: Nothing is known.
    """
    file, from_file, file_error = file_in_use(settings), None, ""
    if file is not None:
        try:
            from_file = load_hand_eye(file, np.inf)
        except HandEyeError as error:
            file_error = f" ({error})"
    from_ruler = None
    if settings.rough_xyz_m is not None:
        T = from_rotation_vector(settings.rough_xyz_m, settings.rough_rotation_rad)
        from_ruler = HandEye(T, None, None, None, hashlib.sha256(T.tobytes()).hexdigest())
    if from_file is None and from_ruler is None and nominal is None:
        raise _no_guess_error(file_error)
    return InitialGuess(from_file, from_ruler, nominal, file_error)


def verifiable_hand_eye(settings: HandEyeSettings) -> HandEye:
    """Load the active calibration, of any age, for a verification.

    Raises:
        CalibrationError: There is no calibration, or its file lacks the board, the board's pose, the covariance or the
            camera matrix.
    """
    file = file_in_use(settings)
    if file is None:
        raise CalibrationError(f"there is no hand-eye calibration to verify yet: {CALIBRATE}")
    try:
        hand_eye = load_hand_eye(file, np.inf)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error
    if any(needed is None for needed in (hand_eye.board, hand_eye.T_base_board, hand_eye.covariance, hand_eye.K)):
        raise CalibrationError(
            f"{file} does not say with which board the cell was calibrated and where the board lay, so the calibration "
            "cannot be verified: calibrate the cell with `pointchain calibrate run`"
        )
    return hand_eye


def require_own_devices(hand_eye: HandEye, camera_id: str | None, robot_serial: str | None) -> None:
    """Raise CalibrationError if the calibration is of another camera or robot."""
    try:
        require_match(hand_eye, camera_id, robot_serial)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def require_unchanged(prepared: Prepared, settings: HandEyeSettings, nominal: HandEye | None, moment: datetime) -> None:
    """Raise CalibrationError if the active calibration is no longer the prepared one.

    A calibration run needs no active calibration.

    Args:
        prepared: Scan, calibration or verification that runs now.
        settings: Active file and maximum age.
        nominal: Calibration of a simulated cell, or None.
        moment: Start of the run. A calibration that becomes too old during a scan stays usable.
    """
    match prepared:
        case PreparedScan(hand_eye=used):
            if hand_eye_in_use(settings, nominal, moment).sha256 != used.sha256:
                raise CalibrationError(
                    "the hand-eye calibration was changed during the scan: its views would not fit together. Scan again"
                )
        case PreparedVerification(hand_eye=used):
            if verifiable_hand_eye(settings).sha256 != used.sha256:
                raise CalibrationError("the hand-eye calibration was changed during its verification: verify it again")


def _no_guess_error(file_error: str) -> CalibrationError:
    return CalibrationError(
        f"a first calibration needs the approximate pose of the camera on the flange{file_error}: measure with a ruler "
        "from the middle of the flange to the lens along the flange's x, y and z, to 3 cm, and write the distances in "
        "metres to hand_eye.rough_xyz_m = [x, y, z]; where the camera does not look along the flange's z with its x "
        "along the flange's, also write its rotation vector to hand_eye.rough_rotation_rad"
    )


def _require_agreement(file: HandEye, ruler: HandEye) -> None:
    """Raise CalibrationError if the two differ by more than the accuracy of a ruler."""
    difference = inverse(file.T_flange_camera) @ ruler.T_flange_camera
    difference_m, difference_rad = float(np.linalg.norm(difference[:3, 3])), rotation_angle(difference)
    if difference_m <= RULER_M and difference_rad <= RULER_RAD:
        return
    by_file, by_ruler = (", ".join(f"{x:.3f}" for x in each.T_flange_camera[:3, 3]) for each in (file, ruler))
    raise CalibrationError(
        f"the active calibration puts the camera at [{by_file}] m on the flange, hand_eye.rough_xyz_m at [{by_ruler}] "
        f"m, {1000 * difference_m:.0f} mm and {np.degrees(difference_rad):.0f} degrees apart: remove the calibration "
        "file if the camera was remounted, or correct hand_eye.rough_xyz_m and hand_eye.rough_rotation_rad"
    )
