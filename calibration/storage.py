"""The hand-eye calibration on disk: where the camera is on the flange, who measured it with what, and when.

A JSON file: `schema_version` 1, `created` (ISO 8601 with a time zone), `camera_id` and `robot_serial` (null where not
known), and `T_flange_camera` as `{"xyz_m": [x, y, z], "quat_xyzw": [x, y, z, w]}`, metres; whatever else is in it is
left to its writer. The form that recordings carry, `{"T_flange_camera": 4x4 matrix}` alone, is taken too; its age and
its camera are then not known.
"""

import hashlib
import json
import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import (
    HandEyeError,
    HandEyeInvalidError,
    HandEyeMismatchError,
    HandEyeMissingError,
    HandEyeOfTheFutureError,
    HandEyeStaleError,
    HandEyeUnreadableError,
)
from calibration.transforms import NotRigidError, from_quaternion, rigid, to_quaternion

__all__ = ["HandEye", "HandEyeError", "load_hand_eye", "require_match", "write_hand_eye"]

SCHEMA_VERSION = 1
FARTHEST_M = 1.0
"""No camera is farther from the flange that carries it; larger numbers are millimetres."""
CLOCKS_APART = timedelta(hours=1)
"""So much may the clock of the machine that wrote a file be ahead of ours."""
BACKWARDS = -0.2
"""Cosine of the angle between the camera's view and the flange's z from which on it looks back: 102 degrees. Across is
the most that a mounting is meant to turn it."""
LARGEST_BYTES = 16 << 20


@dataclass(frozen=True, eq=False)
class HandEye:
    """A calibration that was read and may be used."""

    T_flange_camera: NDArray[np.float64]
    """(4, 4), maps camera points to the flange."""
    created: datetime | None
    """When it was measured, with a time zone; None: not known."""
    camera_id: str | None
    """The camera's device id; None: not known."""
    robot_serial: str | None
    """The robot's serial number; None: not known."""
    sha256: str
    """Of the file's content, hexadecimal: another one means that it has changed."""
    warnings: tuple[str, ...] = ()
    """What could not be checked, and what looks wrong."""


def load_hand_eye(path: Path, max_age_days: float, now: datetime | None = None) -> HandEye:
    """The calibration in the file `path`, not older than `max_age_days` at `now` (with a time zone; the clock's).

    Raises:
        HandEyeMissingError, HandEyeUnreadableError: the file.
        HandEyeInvalidError: its content.
        HandEyeStaleError, HandEyeOfTheFutureError: its date.
    """
    content = _read(path)
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise HandEyeInvalidError(f"{path} is not JSON: {error}") from error
    if not isinstance(document, dict):
        raise HandEyeInvalidError(f"{path} holds no hand-eye calibration: it is not a JSON object")
    version = document.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION:
        raise HandEyeInvalidError(f"{path} has schema_version {version!r}; {SCHEMA_VERSION} is read")
    T_flange_camera = _transform(path, document)
    created = _created(path, document.get("created"))
    _check_age(path, created, max_age_days, now or datetime.now(UTC))
    names = {key: _name(path, key, document.get(key)) for key in ("camera_id", "robot_serial")}
    unknown = {"created": created} | names
    return HandEye(
        T_flange_camera=T_flange_camera,
        created=created,
        camera_id=names["camera_id"],
        robot_serial=names["robot_serial"],
        sha256=hashlib.sha256(content).hexdigest(),
        warnings=_looking_back(T_flange_camera)
        + tuple(
            f"the hand-eye file does not say {about}"
            for key, about in {
                "created": "when it was made, which is not checked: calibrate anew to have it known",
                "camera_id": "of which camera it is, which is not checked: calibrate anew to have it known",
                "robot_serial": "of which robot it is, which is not checked: calibrate anew to have it known",
            }.items()
            if unknown[key] is None
        ),
    )


def require_match(hand_eye: HandEye, camera_id: str | None, robot_serial: str | None) -> None:
    """Refuses a calibration of another camera or robot; what either side does not know is let pass.

    Raises:
        HandEyeMismatchError: with both names.
    """
    for what, measured, found in (
        ("camera", hand_eye.camera_id, camera_id),
        ("robot", hand_eye.robot_serial, robot_serial),
    ):
        if measured is not None and found is not None and measured != found:
            raise HandEyeMismatchError(
                f"the hand-eye calibration was made with {what} {measured}, this is {what} {found}: calibrate anew, "
                "or name the right file in hand_eye.file"
            )


def write_hand_eye(
    path: Path,
    T_flange_camera: ArrayLike,
    *,
    created: datetime,
    camera_id: str | None = None,
    robot_serial: str | None = None,
) -> None:
    """Writes a calibration; a file of that name is replaced in one step, so nobody reads half of it.

    Raises:
        NotRigidError: T_flange_camera (4, 4) is not a rigid transform.
        HandEyeInvalidError: it is farther from the flange than a camera can be, or `created` has no time zone.
        OSError: the file cannot be written.
    """
    T = rigid(T_flange_camera, "T_flange_camera")
    _check_place(path, T)
    if created.tzinfo is None:
        raise HandEyeInvalidError(f"{path}: created is {created.isoformat()}; a time zone is needed")
    document = {
        "schema_version": SCHEMA_VERSION,
        "created": created.isoformat(timespec="seconds"),
        "camera_id": camera_id,
        "robot_serial": robot_serial,
        "T_flange_camera": {"xyz_m": T[:3, 3].tolist(), "quat_xyzw": to_quaternion(T).tolist()},
    }
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("w") as file:
            json.dump(document, file, indent=2)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        with suppress(OSError):
            part.unlink()
        raise


def _read(path: Path) -> bytes:
    try:
        if not path.is_file():  # a pipe would be waited for
            if path.exists():
                raise HandEyeUnreadableError(f"{path} is not a file: hand_eye.file names the JSON file itself")
            raise HandEyeMissingError(
                f"there is no hand-eye calibration {path}: calibrate, or name another file in hand_eye.file"
            )
        if path.stat().st_size > LARGEST_BYTES:
            raise HandEyeUnreadableError(f"{path} has more than {LARGEST_BYTES >> 20} MiB; it is no calibration")
        return path.read_bytes()
    except OSError as error:
        raise HandEyeUnreadableError(f"{path} cannot be read: {error.strerror}") from error


def _transform(path: Path, document: dict[str, Any]) -> NDArray[np.float64]:
    name = f"{path}: T_flange_camera"
    try:
        value = document["T_flange_camera"]
        if isinstance(value, dict):
            T = from_quaternion(_numbers(name, value, "xyz_m", 3), _numbers(name, value, "quat_xyzw", 4), name)
        else:
            T = rigid(value, name)
    except KeyError as error:
        raise HandEyeInvalidError(f"{path} holds no hand-eye calibration: {error.args[0]} is missing") from error
    except NotRigidError as error:
        raise HandEyeInvalidError(str(error)) from error
    _check_place(path, T)
    return T


def _looking_back(T_flange_camera: NDArray[np.float64]) -> tuple[str, ...]:
    """A warning when the camera looks back along the flange's z: hardly a mounting, rather a mistake in the file."""
    cosine = float(T_flange_camera[2, 2])
    if cosine > BACKWARDS:
        return ()
    degrees = np.degrees(np.arccos(max(cosine, -1.0)))
    return (
        f"by the hand-eye file the camera looks back at the arm, {degrees:.0f} degrees from the flange's z: check that "
        "quat_xyzw has the order x, y, z, w, the real part last, and that T_flange_camera is not given the other way "
        "round",
    )


def _numbers(name: str, values: dict[str, Any], key: str, count: int) -> NDArray[np.float64]:
    try:
        numbers = np.array(values[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise HandEyeInvalidError(f"{name} holds something in {key} that is not a number: {error}") from error
    if numbers.shape != (count,):
        raise HandEyeInvalidError(f"{name} has {str(values[key])[:60]} in {key}; {count} numbers are needed")
    return numbers


def _check_place(path: Path, T_flange_camera: NDArray[np.float64]) -> None:
    far = float(np.linalg.norm(T_flange_camera[:3, 3]))
    if far > FARTHEST_M:
        raise HandEyeInvalidError(
            f"{path}: T_flange_camera puts the camera {far:.4g} m from the flange; up to {FARTHEST_M:g} m is taken: "
            "metres are needed, and these look like millimetres"
        )


def _created(path: Path, value: Any) -> datetime | None:
    if value is None:
        return None
    try:
        created = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        raise HandEyeInvalidError(
            f'{path}: created is {str(value)[:40]!r}; a time as "2026-01-31T12:00:00+00:00" is needed'
        ) from None
    if created.tzinfo is None:
        raise HandEyeInvalidError(f"{path}: created is {value!r}; the time zone is missing, as +00:00")
    return created


def _check_age(path: Path, created: datetime | None, max_age_days: float, now: datetime) -> None:
    if created is None:
        return
    if created > now + CLOCKS_APART:
        raise HandEyeOfTheFutureError(
            f"{path} was made at {created.isoformat()}, and it is {now.isoformat(timespec='seconds')} now: set this "
            "machine's clock, or calibrate anew"
        )
    days = (now - created) / timedelta(days=1)
    if days > max_age_days:
        raise HandEyeStaleError(
            f"{path} is {days:.1f} days old, and hand_eye.max_age_days is {max_age_days:g}: calibrate anew"
        )


def _name(path: Path, key: str, value: object) -> str | None:
    if value is not None and not (isinstance(value, str) and value):
        raise HandEyeInvalidError(f"{path}: {key} is {str(value)[:40]!r}; text or null is needed")
    return value
