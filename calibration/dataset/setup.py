"""The board, the camera and the robot of a calibration, as in `setup.json` of a calibration folder.

`{"schema_version": 1, "mounting": "eye-in-hand" | "eye-to-hand", "board": {"kind", "columns", "rows", "pitch_m",
"marker_m", "dictionary"}, "camera": {"id": text or null, "width", "height", "K": 3x3, "distortion": []},
"robot_serial": text or null, "created": time of the images, ISO 8601 with a time zone, or null}`; metres and pixels.
`K` and the distortion (coefficients of OpenCV, empty for rectified images) are valid for images of this size.
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
"""Maximum width and height of an image, pixels. No camera has more."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Board, camera and robot of a calibration."""

    board: Board
    """The board, with its size as given."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix that the camera reports, pixels."""
    image_size: tuple[int, int]
    """Width and height of the images, pixels."""
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Distortion coefficients in the order of OpenCV; empty for rectified images."""
    camera_id: str | None = None
    """Device id of the camera, or None if not known."""
    robot_serial: str | None = None
    """Serial number of the robot, or None if not known."""
    mounting: Mounting = "eye-in-hand"
    """Whether the camera is on the flange or stands in the cell."""
    created: datetime | None = None
    """Time of the images, with a time zone, or None if not known."""

    @staticmethod
    def from_observations(observations: Observations) -> "Setup":
        """Return the setup of these observations."""
        return Setup(**{name: getattr(observations, name) for name in Setup.__dataclass_fields__})

    def observations(self, views: tuple[BoardView, ...]) -> Observations:
        """Return the observations of this setup with these views."""
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
        """Return the setup."""
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
    """Return the setup as JSON values."""
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
