"""Input of a hand-eye calibration: reported flange poses, and the corners that the camera saw."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

Mounting = Literal["eye-in-hand", "eye-to-hand"]
"""`eye-in-hand`: the camera is on the flange and the board stands in the cell. `eye-to-hand`: the reverse."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners in one image of the board, and the flange pose."""

    name: str
    """Name in messages, for example that of the file."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose that the robot reported at rest, metres."""
    ids: NDArray[np.int64]
    """(N,) numbers of the visible corners, which are rows of `Board.points`."""
    pixels: NDArray[np.float64]
    """(N, 2) pixels of these corners, x then y. The centre of the first pixel is (0, 0)."""
    corner_sigma_px: float | None = None
    """Accuracy that the detector reports, pixels, or None if not known. The solver does not use it."""


@dataclass(frozen=True, eq=False)
class Observations:
    """All views of one calibration. `solve_hand_eye` checks them."""

    board: Board
    """The board, with its size as given."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix that the camera reports, pixels."""
    image_size: tuple[int, int]
    """Width and height of the images, pixels."""
    views: tuple[BoardView, ...]
    """The views, at least eight."""
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Distortion coefficients in the order of OpenCV; empty for rectified images."""
    mounting: Mounting = "eye-in-hand"
    """Whether the camera is on the flange or stands in the cell."""
    camera_id: str | None = None
    """Device id of the camera, or None if not known."""
    robot_serial: str | None = None
    """Serial number of the robot, or None if not known."""
    created: datetime | None = None
    """Time of the images, with a time zone, or None if not known."""

    @property
    def T_base_flange(self) -> NDArray[np.float64]:
        """(N, 4, 4) reported flange poses of the N views, metres."""
        return np.array([view.T_base_flange for view in self.views], dtype=np.float64)
