"""Read and activate hand-eye files: the camera pose on the flange, with camera, robot and time of the measurement.

A hand-eye file is a JSON object with `schema_version` 1, `created` (ISO 8601 with a time zone), `camera_id`,
`robot_serial` and `T_flange_camera` as `{"xyz_m": [x, y, z], "quat_xyzw": [x, y, z, w]}`, metres. An unknown id or time
is null. The file of a calibration result also has the accuracy and the findings, see `calibration.storage.document`.
Unknown members are ignored.

A file with `{"T_flange_camera": 4x4 matrix}` alone, as in recordings, is read too. Its age and camera are unknown.
"""

import contextlib
import hashlib
import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.atomic_write import TooLargeError, read_limited, replace_synced
from calibration.dataset.forms import parse_form
from calibration.errors import (
    HandEyeError,
    HandEyeFutureDateError,
    HandEyeInvalidError,
    HandEyeMismatchError,
    HandEyeMissingError,
    HandEyeRefusedError,
    HandEyeStaleError,
    HandEyeUnreadableError,
)
from calibration.result import Finding, Verdict
from calibration.storage.schema import HandEyeForm, JudgedForm, Metrics
from calibration.storage.writer import check_distance, write_hand_eye, write_result
from calibration.target.board import Board

__all__ = [
    "CHECK_ROTATION",
    "HandEye",
    "HandEyeError",
    "activate",
    "camera_faces_arm_message",
    "load_hand_eye",
    "require_match",
    "write_hand_eye",
    "write_result",
]

MAX_CLOCK_DIFFERENCE = timedelta(hours=25)
"""Maximum time by which a file may be dated in the future. It tolerates a clock that is wrong by a day or a time zone,
because the age of the file is then wrong by about a day only."""
FACES_ARM_COSINE = -0.2
"""Limit of the cosine between the optical axis and flange z (102 degrees). At or below this limit, the camera points
back at the arm. Real mountings stay within 90 degrees."""
CHECK_ROTATION = (
    "check that quat_xyzw has the order x, y, z, w, with the real part last, and that T_flange_camera is not inverted"
)
"""Advice for a camera that points back at the arm."""
MAX_BYTES = 16 << 20
"""Maximum size of a hand-eye file, bytes."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """Usable calibration that was read from a hand-eye file.

    Each field from `covariance` on is None (`findings`: empty) if the file does not contain it.
    """

    T_flange_camera: NDArray[np.float64]
    """(4, 4) camera pose on the flange; maps camera points to the flange frame, metres."""
    created: datetime | None
    """Time of the measurement, with a time zone; None if unknown."""
    camera_id: str | None
    """Device id of the camera; None if unknown."""
    robot_serial: str | None
    """Serial number of the robot; None if unknown."""
    sha256: str
    """SHA-256 of the file content, hexadecimal."""
    warnings: tuple[str, ...] = ()
    """Messages about properties that could not be checked or that look wrong."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6) covariance of the error of `T_flange_camera`, as in `HandEyeResult.covariance`."""
    joint_covariance: NDArray[np.float64] | None = None
    """(17, 17) as in `HandEyeResult.joint_covariance`, or the block (12, 12) of X and Y."""
    T_base_board: NDArray[np.float64] | None = None
    """(4, 4) pose of the board during the calibration, base frame, metres."""
    board: Board | None = None
    """The board of the calibration, with its nominal size."""
    board_scale: float | None = None
    """Estimated size of the board divided by its nominal size."""
    K: NDArray[np.float64] | None = None
    """(3, 3) fitted pinhole matrix, pixels."""
    robot_sigma_m: float | None = None
    """Estimated standard deviation of the robot position error per axis, metres."""
    robot_sigma_rad: float | None = None
    """Estimated standard deviation of the robot rotation error per axis, radians."""
    repeatability_95_m: float | None = None
    """Predicted repeatability of a scan, metres, as in `HandEyeResult.repeatability_95_m`."""
    views_used: int | None = None
    """Number of views from which the calibration was estimated."""
    verdict: Verdict | None = None
    """`accept` or `warn`. Calibrations with the verdict `refuse` are not loaded."""
    findings: tuple[Finding, ...] = ()
    """Findings of the calibration, none of them blocking. `warnings` contains their messages."""


def load_hand_eye(path: str | os.PathLike[str], max_age_days: float, now: datetime | None = None) -> HandEye:
    """Read a hand-eye file and check that its calibration may be used.

    Args:
        path: The JSON file.
        max_age_days: Maximum age. `math.inf` accepts any age.
        now: Current time with a time zone. None: the clock of this machine.

    Raises:
        HandEyeMissingError: The file does not exist.
        HandEyeUnreadableError: The file cannot be read.
        HandEyeInvalidError: The content is not valid, or the camera is in the cell (eye-to-hand).
        HandEyeRefusedError: The file has a blocking finding, a failed verification or the verdict `refuse`.
        HandEyeStaleError: The calibration is older than `max_age_days`.
        HandEyeFutureDateError: The date of the calibration is more than `MAX_CLOCK_DIFFERENCE` in the future.
    """
    path = Path(path)
    content = _read(
        path, "calibrate, or set hand_eye.file to another file", "set hand_eye.file to the JSON file itself"
    )
    return _parse(path, content, max_age_days, now or datetime.now(UTC))


def activate(
    run_file: str | os.PathLike[str],
    active_file: str | os.PathLike[str],
    camera_id: str | None = None,
    robot_serial: str | None = None,
) -> HandEye:
    """Activate a calibration atomically and keep the previous active file as `*.previous.json`.

    Args:
        run_file: File of the calibration to activate, of any age.
        active_file: File of the active calibration, which is replaced.
        camera_id: Device id of the camera in the cell. None: unknown, and not compared.
        robot_serial: Serial number of the robot in the cell. None: unknown, and not compared.

    Returns:
        The activated calibration.

    Raises:
        HandEyeError: A check of `load_hand_eye` or `require_match` failed. The active file is unchanged.
        OSError: A file cannot be written. The active file is unchanged.
    """
    run_file = Path(run_file)
    active_file = Path(active_file)
    which = "give the file of a solved calibration, or the folder of its run"
    content = _read(run_file, which, which)
    hand_eye = _parse(run_file, content, float("inf"), datetime.now(UTC))
    require_match(hand_eye, camera_id, robot_serial)
    active_file.parent.mkdir(parents=True, exist_ok=True)
    former = None
    with contextlib.suppress(FileNotFoundError, IsADirectoryError, TooLargeError):
        former = read_limited(active_file, MAX_BYTES)
    if former not in (None, content):  # Activating the same file twice must not overwrite the backup.
        replace_synced(previous_path(active_file), former)
    replace_synced(active_file, content)
    return hand_eye


def previous_path(active_file: str | os.PathLike[str]) -> Path:
    """Return the path of the backup of the previously active calibration."""
    active_file = Path(active_file)
    return active_file.with_name(f"{active_file.stem}.previous.json")


def require_match(hand_eye: HandEye, camera_id: str | None, robot_serial: str | None) -> None:
    """Check that a calibration was made with the camera and the robot in the cell.

    A property that is None in the calibration or in the arguments is not compared.

    Args:
        hand_eye: The calibration.
        camera_id: Device id of the camera in the cell. None: unknown.
        robot_serial: Serial number of the robot in the cell. None: unknown.

    Raises:
        HandEyeMismatchError: The camera or the robot differs. The message gives the expected and the actual one.
    """
    for what, measured, found in (
        ("camera", hand_eye.camera_id, camera_id),
        ("robot", hand_eye.robot_serial, robot_serial),
    ):
        if measured is not None and found is not None and measured != found:
            raise HandEyeMismatchError(
                f"the hand-eye calibration was made with {what} {measured}, this is {what} {found}: calibrate again, "
                "or set hand_eye.file to the right file"
            )


def _read(path: Path, missing: str, no_file: str) -> bytes:
    """Return the content of a file.

    Args:
        path: Path of the file.
        missing: Advice in the error for an absent path.
        no_file: Advice in the error for a folder.
    """
    try:
        return read_limited(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise HandEyeMissingError(f"there is no hand-eye calibration {path}: {missing}") from error
    except IsADirectoryError as error:
        raise HandEyeUnreadableError(f"{error}: {no_file}") from error
    except TooLargeError as error:
        raise HandEyeUnreadableError(f"{error}; this is not a calibration") from error
    except OSError as error:
        raise HandEyeUnreadableError(f"{path} cannot be read: {error.strerror}") from error


def _parse(path: Path, content: bytes, max_age_days: float, now: datetime) -> HandEye:
    """Parse the content of a hand-eye file and check that its calibration may be used."""
    judged = parse_form(JudgedForm, content, path, HandEyeInvalidError)
    findings = tuple(Finding(**vars(finding)) for finding in judged.findings or [])
    if judged.refusals:
        why = "; ".join(judged.refusals)
        raise HandEyeRefusedError(f"the calibration {path} was refused when it was solved: {why}")
    if judged.mounting != "eye-in-hand" or judged.T_base_camera is not None:
        raise HandEyeInvalidError(
            f"{path} is the calibration of a camera that stands in the cell (eye-to-hand); a camera on the "
            "flange is needed"
        )
    form = parse_form(HandEyeForm, content, path, HandEyeInvalidError)
    check_distance(path, form.T_flange_camera)
    _check_age(path, form.created, max_age_days, now)
    return HandEye(
        T_flange_camera=form.T_flange_camera,
        created=form.created,
        camera_id=form.camera_id,
        robot_serial=form.robot_serial,
        sha256=hashlib.sha256(content).hexdigest(),
        warnings=_faces_arm_warnings(form.T_flange_camera)
        + _missing_field_warnings(form)
        + tuple(finding.message for finding in findings),
        covariance=form.covariance_matrix,
        joint_covariance=form.joint_covariance,
        T_base_board=form.T_base_board,
        board=form.board,
        board_scale=form.board_scale,
        K=form.camera_matrix,
        verdict=form.verdict,
        findings=findings,
        **vars(form.metrics or Metrics()),
    )


def _missing_field_warnings(form: HandEyeForm) -> tuple[str, ...]:
    """Return one warning for each of time, camera and robot that the file does not contain."""
    properties = {
        "when it was made": form.created,
        "of which camera it is": form.camera_id,
        "of which robot it is": form.robot_serial,
    }
    return tuple(
        f"the hand-eye file does not say {about}, so this is not checked: calibrate again to record it"
        for about, value in properties.items()
        if value is None
    )


def camera_faces_arm_message(T_flange_camera: NDArray[np.float64]) -> str:
    """Describe a camera that points back at the arm, with the angle between its optical axis and flange z.

    Args:
        T_flange_camera: (4, 4) pose of this camera on the flange.
    """
    degrees = np.degrees(np.arccos(max(float(T_flange_camera[2, 2]), -1.0)))
    return f"by the hand-eye file the camera looks back at the arm, {degrees:.0f} degrees from the flange's z"


def _faces_arm_warnings(T_flange_camera: NDArray[np.float64]) -> tuple[str, ...]:
    """Return a warning if the camera points back at the arm. Such a pose indicates an error in the file."""
    if T_flange_camera[2, 2] > FACES_ARM_COSINE:
        return ()
    return (f"{camera_faces_arm_message(T_flange_camera)}: {CHECK_ROTATION}",)


def _check_age(path: Path, created: datetime | None, max_age_days: float, now: datetime) -> None:
    """Check that a calibration is neither too old nor dated in the future."""
    if created is None:
        return
    if created > now + MAX_CLOCK_DIFFERENCE:
        raise HandEyeFutureDateError(
            f"{path} was made at {created.isoformat()}, and the time is {now.isoformat(timespec='seconds')}: set the "
            "clock of this machine, or calibrate again"
        )
    days = (now - created) / timedelta(days=1)
    if not days <= max_age_days:
        raise HandEyeStaleError(
            f"{path} is {days:.1f} days old, and hand_eye.max_age_days is {max_age_days:g}: calibrate again"
        )
