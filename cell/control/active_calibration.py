"""The hand-eye calibration that a scan uses, and what refuses it; and the rough one that a calibration begins with."""

import hashlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from calibration.errors import HandEyeError
from calibration.geometry.transforms import from_rotation_vector, inverse, rotation_angle
from calibration.storage.hand_eye_file import HandEye, load_hand_eye, require_match
from cell.config.cell_config import HandEyeSettings
from cell.errors import CalibrationError
from cell.simulation.devices.world import SimulatedWorld

MAKE_ONE = "calibrate the cell with `pointchain calibrate run`, or name the file of a calibration in hand_eye.file"

RULER_M, RULER_RAD = 0.03, np.deg2rad(10.0)
"""As sure as a ruler is asked to be: a file that differs by more is of another mounting."""


def hand_eye_in_use(settings: HandEyeSettings, world: SimulatedWorld | None, moment: datetime | None = None) -> HandEye:
    """The calibration of the active file; where there is none yet, what is told of a simulated cell's `world`.

    `moment`: the one at which it must not be too old; the present unless given.

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
        return load_hand_eye(file, settings.max_age_days, moment)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def file_in_use(settings: HandEyeSettings) -> Path | None:
    """The active file; None where no file is configured and none was made yet."""
    file = settings.active_file
    return None if file is None or (settings.file is None and not file.exists()) else file


@dataclass(frozen=True, eq=False)
class RoughHandEyes:
    """What tells about where the camera is, best first; at least one of them does."""

    by_file: HandEye | None
    """By the active file, however old."""
    by_ruler: HandEye | None
    by_world: HandEye | None
    """Of a simulated cell."""
    why: str = ""
    """In brackets, why the file does not tell it."""

    def of(self, camera_id: str | None, robot_serial: str | None) -> HandEye:
        """The best for this camera and robot: the arm is moved by it.

        Raises:
            CalibrationError: the file is of another camera or robot and nothing else tells it, or the ruler tells
                another place than the file.
        """
        file, why = self.by_file, self.why
        if file is not None:
            try:
                require_match(file, camera_id, robot_serial)
            except HandEyeError as error:
                file, why = None, f" ({error})"
        if file is not None:
            if self.by_ruler is not None:
                _require_alike(file, self.by_ruler)
            return file
        other = self.by_ruler or self.by_world
        if other is None:
            raise _nothing_known(why)
        return other


def rough_hand_eyes(settings: HandEyeSettings, world: SimulatedWorld | None) -> RoughHandEyes:
    """What is known of the mounting before a calibration; asks no device anything.

    Raises:
        CalibrationError: nothing is known.
    """
    file, by_file, why = file_in_use(settings), None, ""
    if file is not None:
        try:
            by_file = load_hand_eye(file, np.inf)
        except HandEyeError as error:
            why = f" ({error})"
    by_ruler = None
    if settings.rough_xyz_m is not None:
        T = from_rotation_vector(settings.rough_xyz_m, settings.rough_rotation_rad)
        by_ruler = HandEye(T, None, None, None, hashlib.sha256(T.tobytes()).hexdigest())
    by_world = None if world is None else world.told_hand_eye
    if by_file is None and by_ruler is None and by_world is None:
        raise _nothing_known(why)
    return RoughHandEyes(by_file, by_ruler, by_world, why)


def _nothing_known(why: str) -> CalibrationError:
    return CalibrationError(
        f"a first calibration needs to know roughly where the camera is{why}: measure with a ruler from the middle of "
        "the flange to the lens along the flange's x, y and z, to 3 cm, and give it in metres as hand_eye.rough_xyz_m "
        "= [x, y, z]; where the camera does not look along the flange's z with its x along the flange's, also "
        "hand_eye.rough_rotation_rad, its rotation vector"
    )


def _require_alike(file: HandEye, ruler: HandEye) -> None:
    """Whoever measured anew after the camera was mounted otherwise means the ruler, not the old file."""
    off = inverse(file.T_flange_camera) @ ruler.T_flange_camera
    off_m, off_rad = float(np.linalg.norm(off[:3, 3])), rotation_angle(off)
    if off_m <= RULER_M and off_rad <= RULER_RAD:
        return
    by_file, by_ruler = (", ".join(f"{x:.3f}" for x in told.T_flange_camera[:3, 3]) for told in (file, ruler))
    raise CalibrationError(
        f"the calibration in use puts the camera at [{by_file}] m on the flange, hand_eye.rough_xyz_m at [{by_ruler}] "
        f"m, {1000 * off_m:.0f} mm and {np.degrees(off_rad):.0f} degrees apart: take the file of the calibration away, "
        "or correct hand_eye.rough_xyz_m and hand_eye.rough_rotation_rad"
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


def require_its_own(hand_eye: HandEye, camera_id: str | None, robot_serial: str | None) -> None:
    """Refuses the calibration of another camera or robot. Raises CalibrationError."""
    try:
        require_match(hand_eye, camera_id, robot_serial)
    except HandEyeError as error:
        raise CalibrationError(str(error)) from error


def require_still_verified(used: HandEye, settings: HandEyeSettings) -> None:
    """Refuses to go on when the calibration being verified is no longer the one in use. Raises CalibrationError."""
    if verifiable_hand_eye(settings).sha256 != used.sha256:
        raise CalibrationError("the hand-eye calibration was changed while it was to be verified: verify it again")


def require_unchanged(used: HandEye, now: HandEye) -> None:
    """Refuses to go on when the calibration is not that of the scan's beginning. Raises CalibrationError."""
    if now.sha256 != used.sha256:
        raise CalibrationError(
            "the hand-eye calibration was changed during the scan: its views would not fit together. Scan again"
        )
