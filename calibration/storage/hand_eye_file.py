"""The hand-eye file: the pose of the camera on the flange, with the camera, the robot and the time of the measurement.

It is a JSON file with `schema_version` 1, `created` (ISO 8601 with a time zone), `camera_id` and `robot_serial` (null
if not known), and `T_flange_camera` as `{"xyz_m": [x, y, z], "quat_xyzw": [x, y, z, w]}`, metres. A solved calibration
has its accuracy and findings too, as in `calibration.storage.document`. Other members are ignored. The form that
recordings have, `{"T_flange_camera": 4x4 matrix}` alone, is read as well; its age and its camera are then not known.
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
    "load_hand_eye",
    "looks_back_message",
    "require_match",
    "write_hand_eye",
    "write_result",
]

MAX_CLOCK_DIFFERENCE = timedelta(hours=25)
"""Maximum time by which a file may be dated in the future. A clock that is wrong by a day or a time zone must not stop
work, since it makes the age of the file wrong by a day only."""
LOOKS_BACK_COSINE = -0.2
"""Cosine of the angle between the view of the camera and the z axis of the flange, from which the camera looks back:
102 degrees. A mounting turns the camera by 90 degrees at most."""
CHECK_ROTATION = (
    "check that quat_xyzw has the order x, y, z, w, with the real part last, and that T_flange_camera is not inverted"
)
"""What to do if the camera looks back."""
MAX_BYTES = 16 << 20
"""Maximum size of the file."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """A calibration that was read from a file and may be used."""

    T_flange_camera: NDArray[np.float64]
    """(4, 4) camera pose on the flange; maps camera points to the flange frame, metres."""
    created: datetime | None
    """Time of the measurement, with a time zone, or None if not known."""
    camera_id: str | None
    """Device id of the camera, or None if not known."""
    robot_serial: str | None
    """Serial number of the robot, or None if not known."""
    sha256: str
    """SHA-256 of the content of the file, hexadecimal."""
    warnings: tuple[str, ...] = ()
    """What could not be checked, and what looks wrong."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6) as in `HandEyeResult`. This and the following fields are None if the file does not have them."""
    joint_covariance: NDArray[np.float64] | None = None
    """(17, 17) as in `HandEyeResult`, or (12, 12) of X and Y alone."""
    T_base_board: NDArray[np.float64] | None = None
    """(4, 4) pose of the board during the calibration."""
    board: Board | None = None
    """The board of the calibration, with its size as given."""
    board_scale: float | None = None
    """Estimated size of the board, as a share of the given size."""
    K: NDArray[np.float64] | None = None
    """(3, 3) fitted pinhole matrix, pixels."""
    robot_sigma_m: float | None = None
    """Estimated noise of the robot's position along one axis, metres, one sigma."""
    robot_sigma_rad: float | None = None
    """Estimated noise of the robot's rotation about one axis, radians, one sigma."""
    repeatability_95_m: float | None = None
    """Predicted bound, metres. In 95 % of scans, no two of eight views disagree by more."""
    views_used: int | None = None
    """Number of views that it was solved from."""
    verdict: Verdict | None = None
    """`accept` or `warn`; a refused calibration is not loaded."""
    findings: tuple[Finding, ...] = ()
    """Findings that do not refuse the calibration. Their messages are among the warnings."""


def load_hand_eye(path: str | os.PathLike[str], max_age_days: float, now: datetime | None = None) -> HandEye:
    """Read a hand-eye calibration from a file and check that it may be used.

    Args:
        path: The JSON file.
        max_age_days: Maximum age. `math.inf` accepts any age.
        now: Time with a time zone. None: the clock of this machine.

    Raises:
        HandEyeMissingError: There is no such file.
        HandEyeUnreadableError: The file cannot be read.
        HandEyeInvalidError: The content is not valid, or the camera stands in the cell.
        HandEyeRefusedError: The calibration was refused when it was solved.
        HandEyeStaleError: It is too old.
        HandEyeFutureDateError: Its date is in the future.
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
    """Make a solved calibration the active one in one step, and keep the former one as `*.previous.json`.

    Args:
        run_file: File of the solved calibration, of any age.
        active_file: File of the active calibration.
        camera_id: Device id of the camera that will use it. None: not known, and not compared.
        robot_serial: Serial number of the robot that will use it. None: not known, and not compared.

    Raises:
        HandEyeError: As `load_hand_eye` and `require_match`. The former calibration stays active.
        OSError: A file cannot be written. The former calibration stays active.
    """
    run_file, active_file = Path(run_file), Path(active_file)
    which = "give the file of a solved calibration, or the folder of its run"
    content = _read(run_file, which, which)
    hand_eye = _parse(run_file, content, float("inf"), datetime.now(UTC))
    require_match(hand_eye, camera_id, robot_serial)
    active_file.parent.mkdir(parents=True, exist_ok=True)
    former = None
    with contextlib.suppress(FileNotFoundError, IsADirectoryError, TooLargeError):
        former = read_limited(active_file, MAX_BYTES)
    if former not in (None, content):  # a second activation keeps the former calibration
        replace_synced(previous_path(active_file), former)
    replace_synced(active_file, content)
    return hand_eye


def previous_path(active_file: str | os.PathLike[str]) -> Path:
    """Return the path at which the formerly active calibration is kept."""
    active_file = Path(active_file)
    return active_file.with_name(f"{active_file.stem}.previous.json")


def require_match(hand_eye: HandEye, camera_id: str | None, robot_serial: str | None) -> None:
    """Check that a calibration belongs to a camera and a robot. Unknown names on either side are not compared.

    Args:
        hand_eye: The calibration.
        camera_id: Device id of the camera. None: not known.
        robot_serial: Serial number of the robot. None: not known.

    Raises:
        HandEyeMismatchError: Camera or robot differ. The message names both.
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
    """Read the file. `missing` and `no_file` say what to do if it does not exist or is a folder."""
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
    """Parse the content of a hand-eye file, and check that it may be used."""
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
        warnings=_looks_back_warnings(form.T_flange_camera)
        + _unknown(form)
        + tuple(finding.message for finding in findings),
        covariance=np.array(form.covariance.matrix) if form.covariance else None,
        joint_covariance=form.joint_covariance,
        T_base_board=form.T_base_board,
        board=form.board,
        board_scale=form.board_scale,
        K=np.array(form.intrinsics.K) if form.intrinsics else None,
        verdict=form.verdict,
        findings=findings,
        **vars(form.metrics or Metrics()),
    )


def _unknown(form: HandEyeForm) -> tuple[str, ...]:
    """Return a warning for each property that is not known and not checked."""
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


def looks_back_message(T_flange_camera: NDArray[np.float64]) -> str:
    """Return a message that the camera looks back at the arm, with the angle between its view and the flange's z."""
    degrees = np.degrees(np.arccos(max(float(T_flange_camera[2, 2]), -1.0)))
    return f"by the hand-eye file the camera looks back at the arm, {degrees:.0f} degrees from the flange's z"


def _looks_back_warnings(T_flange_camera: NDArray[np.float64]) -> tuple[str, ...]:
    """Return a warning if the camera looks back along the flange's z: this is a mistake in the file, not a mounting."""
    if T_flange_camera[2, 2] > LOOKS_BACK_COSINE:
        return ()
    return (f"{looks_back_message(T_flange_camera)}: {CHECK_ROTATION}",)


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
