"""Board, camera and robot of a calibration, and the schema of the file `setup.json`.

The members of `setup.json` are

    schema_version  1
    mounting        "eye-in-hand" or "eye-to-hand"
    board           kind, columns, rows, pitch_m; for ChArUco also marker_m, dictionary
    camera          id (or null), width and height (pixels), K (3x3, pixels), distortion (coefficients)
    robot_serial    serial number, or null
    created         time of the images, ISO 8601 with a time zone, or null

The distortion coefficients are in OpenCV order; the list is empty for rectified images. `K` and `distortion` must
belong to images of the given width and height.
"""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from calibration.dataset.forms import BoardField, Form, PinholeMatrix, Timestamp, time_to_json
from calibration.input_checks.camera import DISTORTION_SIZES
from calibration.observations import BoardView, Mounting, Observations
from calibration.target.board import Board

__all__ = ["Setup", "SetupForm", "setup_to_json"]

SCHEMA_VERSION = 1
"""Version of the format of `setup.json`."""
MAX_SIDE_PX = 16384
"""Maximum width and height of an image, pixels."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Board, camera and robot of a calibration."""

    board: Board
    """The board, with its nominal size."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix reported by the camera, pixels."""
    image_size: tuple[int, int]
    """Width and height of the images, pixels."""
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Distortion coefficients in OpenCV order; empty for rectified images."""
    camera_id: str | None = None
    """Device id of the camera; None if unknown."""
    robot_serial: str | None = None
    """Serial number of the robot; None if unknown."""
    mounting: Mounting = "eye-in-hand"
    """Whether the camera is on the flange or in the cell."""
    created: datetime | None = None
    """Time at which the images were taken, with a time zone; None if unknown."""

    @staticmethod
    def from_observations(observations: Observations) -> "Setup":
        """Return the setup of the given observations."""
        return Setup(**{name: getattr(observations, name) for name in Setup.__dataclass_fields__})

    def observations(self, views: tuple[BoardView, ...]) -> Observations:
        """Combine the setup and the given views into observations."""
        return Observations(views=views, **{name: getattr(self, name) for name in Setup.__dataclass_fields__})


def _check_coefficients(distortion: list[float]) -> list[float]:
    if len(distortion) not in DISTORTION_SIZES:
        *counts, last = DISTORTION_SIZES
        raise ValueError(
            f"there are {len(distortion)} coefficients; OpenCV needs {', '.join(map(str, counts))} or {last}"
        )
    return distortion


Pixels = Annotated[int, Field(ge=1, le=MAX_SIDE_PX)]


class _CameraForm(Form, extra="forbid"):
    id: str | None = None
    width: Pixels
    height: Pixels
    K: PinholeMatrix
    distortion: Annotated[list[float], Field(fail_fast=True), AfterValidator(_check_coefficients)] | None = None


class SetupForm(Form, extra="forbid"):
    """Schema of `setup.json`."""

    schema_version: Literal[1] = SCHEMA_VERSION
    mounting: Mounting = "eye-in-hand"
    board: BoardField
    camera: _CameraForm
    robot_serial: str | None = None
    created: Timestamp | None = None

    def to_setup(self) -> Setup:
        """Convert the validated JSON object to a setup."""
        return Setup(
            board=self.board,
            K=np.array(self.camera.K),
            image_size=(self.camera.width, self.camera.height),
            distortion=np.array(self.camera.distortion or []),
            camera_id=self.camera.id,
            robot_serial=self.robot_serial,
            mounting=self.mounting,
            created=self.created,
        )


def setup_to_json(setup: Setup) -> dict[str, Any]:
    """Convert a setup to the JSON object of `setup.json`."""
    width, height = setup.image_size
    return {
        "schema_version": SCHEMA_VERSION,
        "mounting": setup.mounting,
        "board": setup.board.to_json(),
        "camera": {
            "id": setup.camera_id,
            "width": width,
            "height": height,
            "K": setup.K.tolist(),
            "distortion": setup.distortion.tolist(),
        },
        "robot_serial": setup.robot_serial,
        "created": time_to_json(setup.created),
    }
