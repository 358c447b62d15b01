"""What a hand-eye calibration is solved from: where the robot said it was, and which corners the camera saw there."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.board import Board

Mounting = Literal["eye-in-hand", "eye-to-hand"]
"""The camera on the flange and the board fixed in the cell, or the other way round."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """One picture of the board."""

    name: str
    """By which a person finds it: the file's name, or its number."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) as the robot told it, at rest."""
    ids: NDArray[np.int64]
    """(N,) numbers of the corners seen: rows of `Board.points`."""
    pixels: NDArray[np.float64]
    """(N, 2) where, x then y; the centre of the first pixel is (0, 0)."""
    corner_sigma_px: float | None = None
    """How exactly the detector found them, by its own account; None: not told."""


@dataclass(frozen=True, eq=False)
class Observations:
    """All pictures of one calibration. Not checked here: `calibration.hand_eye.solve_hand_eye` does."""

    board: Board
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix as the camera tells it, pixels."""
    image_size: tuple[int, int]
    """Width and height, pixels."""
    views: tuple[BoardView, ...]
    distortion: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """OpenCV's coefficients; empty for a rectified image."""
    mounting: Mounting = "eye-in-hand"
    camera_id: str | None = None
    """Device id; None: not known."""
    robot_serial: str | None = None
    created: datetime | None = None
    """When the pictures were taken, with a time zone; None: not known."""
