"""What does not change during a calibration: the board, the camera, the robot; as in the folder form's `setup.json`.

`{"schema_version": 1, "mounting": "eye-in-hand" | "eye-to-hand", "board": {"kind", "columns", "rows", "pitch_m",
"marker_m", "dictionary"}, "camera": {"id": text or null, "width", "height", "K": 3x3, "distortion": []},
"robot_serial": text or null, "created": when the pictures were taken, ISO 8601 with a time zone, or null}`; metres and
pixels. `K` and the distortion (OpenCV's coefficients, empty for rectified images) are of images of this size.
"""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from calibration.dataset.forms import BoardObject, Form, PinholeMatrix, Time, time_document
from calibration.observations import BoardView, Mounting, Observations
from calibration.target.board import Board

__all__ = ["Setup", "SetupForm", "setup_document"]

SCHEMA_VERSION = 1
MOST_PIXELS = 16384
"""No camera's image is wider or higher."""
COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""So many distortion coefficients OpenCV takes."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Board, camera and robot of a calibration."""

    board: Board
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix as the camera tells it, pixels."""
    image_size: tuple[int, int]
    """Width and height, pixels."""
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """OpenCV's coefficients; empty for rectified images."""
    camera_id: str | None = None
    robot_serial: str | None = None
    mounting: Mounting = "eye-in-hand"
    created: datetime | None = None
    """When the pictures were taken, with a time zone; None: not known."""

    @staticmethod
    def of(observations: Observations) -> "Setup":
        """That of these observations."""
        return Setup(**{name: getattr(observations, name) for name in Setup.__dataclass_fields__})

    def observations(self, views: tuple[BoardView, ...]) -> Observations:
        """What was seen with it."""
        return Observations(views=views, **{name: getattr(self, name) for name in Setup.__dataclass_fields__})


def _coefficients(distortion: list[float]) -> list[float]:
    if len(distortion) not in COEFFICIENTS:
        raise ValueError(f"OpenCV takes {', '.join(map(str, COEFFICIENTS))} numbers, and there are {len(distortion)}")
    return distortion


Pixels = Annotated[int, Field(ge=1, le=MOST_PIXELS)]


class _Camera(Form, extra="forbid"):
    id: str | None = None
    width: Pixels
    height: Pixels
    K: PinholeMatrix
    distortion: Annotated[list[float], Field(fail_fast=True), AfterValidator(_coefficients)] | None = None


class SetupForm(Form, extra="forbid"):
    """The setup in a file."""

    schema_version: Literal[1] = SCHEMA_VERSION
    mounting: Mounting = "eye-in-hand"
    board: BoardObject
    camera: _Camera
    robot_serial: str | None = None
    created: Time | None = None

    def setup(self) -> Setup:
        """What it tells."""
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


def setup_document(setup: Setup) -> dict[str, Any]:
    """The setup as JSON."""
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
        "created": time_document(setup.created),
    }
