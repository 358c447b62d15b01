"""A calibration folder with rendered images and a known solution."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.folder import write_setup, write_view
from calibration.dataset.setup import Setup
from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.target.board import Board
from tests.calibration.board_views import realistic_plan
from tests.calibration.rendered_board import K_640, image_size, render

X = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
"""True pose of the camera on the flange."""
Y = from_rotation_vector((0.42, 0.03, 0.002), (np.pi, 0.0, 0.0)) @ from_rotation_vector((0, 0, 0), (0, 0, 0.7))
"""True pose of the board on the table, face up."""
ROBOT_M, ROBOT_RAD = 1e-4, float(np.radians(0.02))
"""Standard deviations of the robot errors along and about each axis, metres and radians."""


def rendered_folder(
    folder: Path, board: Board | None = None, views: int = 12, held_out: int = 2, mirrored: bool = False
) -> Path:
    """Write images of 640 x 400 pixels of a board on a table from poses of a cell. The last are held out."""
    rng = np.random.default_rng(2)
    board = board or Board()
    write_setup(folder, Setup(board, K_640, image_size(K_640), camera_id="19443010", robot_serial="20225500123"))
    middle = np.eye(4)
    middle[:3, 3] = board.points.mean(axis=0)
    plan = np.concatenate([realistic_plan(rng, views), realistic_plan(rng, max(held_out, 1))[:held_out]])
    for k, T_middle_camera in enumerate(plan):
        T_board_camera = middle @ T_middle_camera
        image = render(board, inverse(T_board_camera), K_640, rng)
        write_view(
            folder,
            f"{k + 1:02d}",
            np.ascontiguousarray(image[:, ::-1]) if mirrored else image,
            _as_reported(Y @ T_board_camera @ inverse(X), rng),
            held_out=k >= views,
        )
    return folder


def _as_reported(T_base_flange: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    error = from_rotation_vector(rng.normal(0, ROBOT_M, 3), rng.normal(0, ROBOT_RAD, 3))
    return T_base_flange @ error
