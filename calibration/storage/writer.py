"""Writes the hand-eye file: a plain one, or a solved one with its observations beside it."""

import json
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.dataset.atomic_write import replace_synced
from calibration.dataset.forms import time_document, transform_document
from calibration.dataset.observations_file import OBSERVATIONS, write_observations
from calibration.errors import HandEyeInvalidError
from calibration.geometry.transforms import rigid
from calibration.observations import Observations
from calibration.result import HandEyeResult
from calibration.storage.document import result_document

SCHEMA_VERSION = 1
FARTHEST_M = 1.0
"""No camera is farther from the flange that carries it; larger numbers are millimetres."""


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
    check_place(path, T)
    _write(path, _head(path, created, camera_id, robot_serial) | {"T_flange_camera": transform_document(T)})


def write_result(
    path: Path,
    result: HandEyeResult,
    observations: Observations,
    held_out: Observations | None = None,
    verification: dict[str, Any] | None = None,
) -> None:
    """Writes a solved calibration, whatever its verdict, and `observations.json` beside it; each in one step.

    It is as old as the observations. `held_out` are the views that it was verified on, `verification` how that went, as
    JSON's values.

    Raises:
        HandEyeInvalidError: the observations' `created` has no time zone, or a result that is not refused puts the
            camera farther from the flange than it can be.
        OSError: a file cannot be written.
    """
    if result.verdict != "refuse" and result.mounting == "eye-in-hand":
        check_place(path, result.X)
    head = _head(path, observations.created, observations.camera_id, observations.robot_serial)
    sha256 = write_observations(path.with_name(OBSERVATIONS), observations, held_out)
    _write(path, head | result_document(result, observations, verification) | {"observations_sha256": sha256})


def check_place(path: Path, T_flange_camera: NDArray[np.float64]) -> None:
    """Refuses a camera that is farther from the flange than one can be. Raises HandEyeInvalidError."""
    far = float(np.linalg.norm(T_flange_camera[:3, 3]))
    if far > FARTHEST_M:
        raise HandEyeInvalidError(
            f"{path}: T_flange_camera puts the camera {far:.4g} m from the flange; up to {FARTHEST_M:g} m is taken: "
            "metres are needed, and these look like millimetres"
        )


def _head(path: Path, created: datetime | None, camera_id: str | None, robot_serial: str | None) -> dict[str, Any]:
    if created is not None and created.tzinfo is None:
        raise HandEyeInvalidError(f"{path}: created is {created.isoformat()}; a time zone is needed")
    return {
        "schema_version": SCHEMA_VERSION,
        "created": time_document(created),
        "camera_id": camera_id,
        "robot_serial": robot_serial,
    }


def _write(path: Path, document: dict[str, Any]) -> None:
    replace_synced(path, (json.dumps(document, indent=2, allow_nan=False) + "\n").encode())
