"""Input of a hand-eye calibration: reported flange poses and detected board corners."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board

Mounting = Literal["eye-in-hand", "eye-to-hand"]
"""`eye-in-hand`: the camera is on the flange, the board in the cell. `eye-to-hand`: the camera is in the cell, the
board on the flange."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """Board corners in one image, with the flange pose at which the image was taken."""

    name: str
    """Name of the view in messages, for example the file name."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) flange pose in the base frame, reported by the robot at rest, metres."""
    ids: NDArray[np.int64]
    """(N,) numbers of the visible corners, which are row indices of `Board.points`."""
    pixels: NDArray[np.float64]
    """(N, 2) positions of the visible corners, x then y, pixels. The centre of the top left pixel is (0, 0)."""
    corner_sigma_px: float | None = None
    """Standard deviation of the corners reported by the detector, pixels; None if unknown. The solver ignores it."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Board, camera and views of one calibration. `solve_hand_eye` checks them."""

    board: Board
    """The board, with its nominal size."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix reported by the camera, pixels."""
    image_size: tuple[int, int]
    """Width and height of the images, pixels."""
    views: tuple[BoardView, ...]
    """The views, at least eight."""
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Distortion coefficients in OpenCV order; empty for rectified images."""
    mounting: Mounting = "eye-in-hand"
    """Whether the camera is on the flange or in the cell."""
    camera_id: str | None = None
    """Device id of the camera; None if unknown."""
    robot_serial: str | None = None
    """Serial number of the robot; None if unknown."""
    created: datetime | None = None
    """Time at which the images were taken, with a time zone; None if unknown."""

    @property
    def T_base_flange(self) -> NDArray[np.float64]:
        """(N, 4, 4) reported flange poses of the N views, base frame, metres."""
        return np.array([view.T_base_flange for view in self.views], dtype=np.float64)
