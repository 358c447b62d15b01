"""Write hand-eye files: from a transform alone, or from a calibration result with its observations."""

import os
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.atomic_write import replace_synced
from calibration.dataset.forms import document_to_bytes, time_to_json, transform_to_json
from calibration.dataset.observations_file import OBSERVATIONS_FILE, write_observations
from calibration.errors import HandEyeInvalidError
from calibration.geometry.transforms import rigid
from calibration.observations import Observations
from calibration.result import HandEyeResult
from calibration.storage.document import result_document

SCHEMA_VERSION = 1
"""Version of the hand-eye file format."""
MAX_DISTANCE_M = 1.0
"""Maximum distance between camera and flange, metres. A larger number is probably in millimetres."""


def write_hand_eye(
    path: str | os.PathLike[str],
    T_flange_camera: ArrayLike,
    *,
    created: datetime,
    camera_id: str | None = None,
    robot_serial: str | None = None,
) -> None:
    """Write a hand-eye file with a transform alone. An existing file is replaced atomically.

    Args:
        path: The JSON file.
        T_flange_camera: (4, 4) pose of the camera on the flange, metres.
        created: Time of the measurement, with a time zone.
        camera_id: Device id of the camera. None: unknown.
        robot_serial: Serial number of the robot. None: unknown.

    Raises:
        NotRigidError: T_flange_camera is not a rigid transform.
        HandEyeInvalidError: The camera is too far from the flange, or `created` has no time zone.
        OSError: The file cannot be written.
    """
    path = Path(path)
    T = rigid(T_flange_camera, "T_flange_camera")
    check_distance(path, T)
    document = _head(path, created, camera_id, robot_serial) | {"T_flange_camera": transform_to_json(T)}
    replace_synced(path, document_to_bytes(document))


def write_result(
    path: str | os.PathLike[str],
    result: HandEyeResult,
    observations: Observations,
    held_out: Observations | None = None,
    verification: dict[str, Any] | None = None,
) -> None:
    """Write a calibration result to a hand-eye file, and its observations to `observations.json` in the same folder.

    Each file is replaced atomically. A result with any verdict is written.

    Args:
        path: The hand-eye file.
        result: The calibration result.
        observations: Views from which the result was estimated. `created` becomes the time of the calibration.
        held_out: Views for verification only. None: no verification.
        verification: Verification result as JSON values. None: no verification.

    Raises:
        HandEyeInvalidError: `observations.created` has no time zone, or the camera is too far from the flange. The
            distance is checked for eye-in-hand results that are not refused.
        OSError: A file cannot be written.
    """
    path = Path(path)
    if result.verdict != "refuse" and result.mounting == "eye-in-hand":
        check_distance(path, result.X)
    head = _head(path, observations.created, observations.camera_id, observations.robot_serial)
    sha256 = write_observations(path.with_name(OBSERVATIONS_FILE), observations, held_out)
    document = head | result_document(result, observations, verification) | {"observations_sha256": sha256}
    replace_synced(path, document_to_bytes(document))


def check_distance(path: Path, T_flange_camera: NDArray[np.float64]) -> None:
    """Check that the camera is at most `MAX_DISTANCE_M` from the flange.

    Args:
        path: The file, for the message.
        T_flange_camera: (4, 4) pose of the camera on the flange, metres.

    Raises:
        HandEyeInvalidError: The distance exceeds `MAX_DISTANCE_M`.
    """
    distance_m = float(np.linalg.norm(T_flange_camera[:3, 3]))
    if distance_m > MAX_DISTANCE_M:
        raise HandEyeInvalidError(
            f"{path}: T_flange_camera puts the camera {distance_m:.4g} m from the flange, and at most "
            f"{MAX_DISTANCE_M:g} m is accepted: give metres; these look like millimetres"
        )


def _head(path: Path, created: datetime | None, camera_id: str | None, robot_serial: str | None) -> dict[str, Any]:
    """Return the members at the start of every hand-eye file; raise if `created` has no time zone."""
    if created is not None and created.tzinfo is None:
        raise HandEyeInvalidError(f"{path}: created is {created.isoformat()}; a time zone is needed")
    return {
        "schema_version": SCHEMA_VERSION,
        "created": time_to_json(created),
        "camera_id": camera_id,
        "robot_serial": robot_serial,
    }
