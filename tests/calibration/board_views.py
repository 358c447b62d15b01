"""Simulated views of a board with known truth: corners with the errors of the camera and the robot."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_rotation_vector, inverse, rotation_angle
from calibration.observations import BoardView, Mounting, Observations
from calibration.result import HandEyeResult
from calibration.target.board import Board

Plan = Callable[[np.random.Generator, int], NDArray[np.float64]]
"""(generator, count) -> (count, 4, 4) `T_middle_camera`: camera poses in the frame of the middle of the board."""

BOARD = Board(columns=8, rows=11, pitch_m=0.02, marker_m=0.015)
"""Board with 70 corners, about as large as a sheet of paper."""
IMAGE = (1280, 800)
K = np.array([[800.0, 0, 639.5], [0, 800.0, 399.5], [0, 0, 1]])


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the random errors of each view, and errors of the given camera and board."""

    pixel_px: float = 0.2
    robot_m: float = 1e-4
    robot_rad: float = float(np.radians(0.02))
    focal: float = 0.0
    """The given focal lengths are too long by this share."""
    centre_px: tuple[float, float] = (0.0, 0.0)
    """The given principal point is too far right and down by this."""
    scale: float = 0.0
    """The board is larger than its given size by this share."""


NOISE_FREE = Noise(pixel_px=0.0, robot_m=0.0, robot_rad=0.0)


@dataclass(frozen=True, eq=False)
class Recorded:
    """Observations for a calibration, and the truth."""

    observations: Observations
    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    K: NDArray[np.float64]
    board_scale: float
    T_camera_board: NDArray[np.float64]
    """True poses (N, 4, 4)."""

    @property
    def T_base_flange(self) -> NDArray[np.float64]:
        """Reported flange poses (N, 4, 4)."""
        return self.observations.T_base_flange


def look_at(
    tilt: float, azimuth: float, roll: float, distance_m: float, aim_m: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float64]:
    """Return `T_middle_camera` (4, 4) of a camera that looks at a point from `distance_m`.

    The camera is tilted by `tilt` from the vertical towards `azimuth`. The x axis of its image is parallel to the
    board, apart from a rotation by `roll` about the line of sight.
    """
    # The z axis of the board points away from the viewer, so the camera is at negative z.
    away = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
    level = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    upright = np.column_stack([level, np.cross(-away, level), -away])
    T = np.eye(4)
    T[:3, :3] = upright @ Rotation.from_euler("z", roll).as_matrix()
    T[:3, 3] = np.array([*aim_m, 0.0]) + distance_m * away
    return T


def random_plan(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses at 0.3 to 0.5 m with tilts of up to 40 degrees in all directions and any roll."""
    return np.array(
        [
            look_at(
                tilt=np.radians(rng.uniform(10, 40)),
                azimuth=rng.uniform(-np.pi, np.pi),
                roll=np.radians(rng.uniform(-90, 90)),
                distance_m=rng.uniform(0.3, 0.5),
                aim_m=(rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02)),
            )
            for _ in range(count)
        ]
    )


def realistic_plan(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses as a cell plans them.

    They have all azimuths, tilts of 20 to 30 degrees, two distances, and rolls of 25 and 75 degrees in both directions.
    """
    rolls = np.radians([25.0, -75.0, -25.0, 75.0])
    poses = []
    for k in range(count):
        tilt = np.radians(rng.uniform(20, 30))
        azimuth = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / count
        roll = np.pi / 2 - azimuth + rolls[k % 4] + np.radians(rng.uniform(-3, 3))
        distance_m = (0.34, 0.46)[(k // 2) % 2] + rng.uniform(-0.01, 0.01)
        poses.append(look_at(tilt, azimuth, roll, distance_m, (rng.uniform(-0.01, 0.01), rng.uniform(-0.01, 0.01))))
    return np.array(poses)


def orbit_plan(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses at one distance towards the middle, which do not determine the size of the board."""
    return np.array(
        [
            look_at(
                tilt=np.radians(rng.uniform(20, 30)),
                azimuth=2 * np.pi * k / count,
                roll=np.radians(rng.uniform(-75, 75)),
                distance_m=0.4,
            )
            for k in range(count)
        ]
    )


def record(
    seed: int,
    count: int = 20,
    noise: Noise | None = None,
    plan: Plan = random_plan,
    mounting: Mounting = "eye-in-hand",
    board: Board = BOARD,
) -> Recorded:
    """Return `count` views of a random cell. The same seed gives the same views."""
    rng = np.random.default_rng(seed)
    noise = noise or Noise()
    T_board_middle = np.eye(4)
    T_board_middle[:3, 3] = (1 + noise.scale) * board.points.mean(axis=0)
    T_camera_board = np.array([inverse(T_board_middle @ T_middle_camera) for T_middle_camera in plan(rng, count)])
    X, Y = _in_hand(rng) if mounting == "eye-in-hand" else _to_hand(rng)
    views = []
    for k, T in enumerate(T_camera_board):
        error = from_rotation_vector(rng.normal(0, noise.robot_m, 3), rng.normal(0, noise.robot_rad, 3))
        T_base_flange = Y @ inverse(T) @ inverse(X) if mounting == "eye-in-hand" else X @ T @ inverse(Y)
        ids, pixels = _seen(T, board, 1 + noise.scale)
        views.append(
            BoardView(
                name=f"{k + 1:02d}",
                T_base_flange=T_base_flange @ inverse(error),
                ids=ids,
                pixels=pixels + rng.normal(0, noise.pixel_px, pixels.shape),
            )
        )
    given_K = K.copy()
    given_K[:2, :2] *= 1 + noise.focal
    given_K[:2, 2] += noise.centre_px
    observations = Observations(board=board, K=given_K, image_size=IMAGE, views=tuple(views), mounting=mounting)
    return Recorded(observations, X, Y, K.copy(), 1 + noise.scale, T_camera_board)


def with_poses(observations: Observations, T_base_flange: NDArray[np.float64]) -> Observations:
    """Return the same images with other poses (N, 4, 4)."""
    views = (replace(view, T_base_flange=T) for view, T in zip(observations.views, T_base_flange, strict=True))
    return replace(observations, views=tuple(views))


def with_swapped_pictures(observations: Observations, first: int, second: int) -> Observations:
    """Return observations with two images swapped between their poses."""
    order = list(range(len(observations.views)))
    order[first], order[second] = second, first
    views = (
        replace(view, ids=observations.views[other].ids, pixels=observations.views[other].pixels)
        for view, other in zip(observations.views, order, strict=True)
    )
    return replace(observations, views=tuple(views))


def with_turned_board(observations: Observations, index: int) -> Observations:
    """Return observations with the board numbered from the opposite corner in one image."""
    views = list(observations.views)
    view = views[index]
    views[index] = replace(view, ids=len(observations.board.points) - 1 - view.ids)
    return replace(observations, views=tuple(views))


def error_of(X: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Return the error of `X` in degrees and millimetres."""
    return float(np.degrees(rotation_angle(inverse(truth) @ X))), float(1e3 * np.linalg.norm(X[:3, 3] - truth[:3, 3]))


def squared_error_in_sigmas(result: HandEyeResult, truth: NDArray[np.float64]) -> float:
    """Return the squared error of X normalised by its covariance (NEES), 6 on average for a correct covariance."""
    difference = inverse(result.X) @ truth
    error = np.concatenate([Rotation.from_matrix(difference[:3, :3]).as_rotvec(), difference[:3, 3]])
    return float(error @ np.linalg.solve(result.covariance, error))


def _in_hand(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return X and Y of a camera beside the flange with any roll and a small tilt, and of a board on the table."""
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)) * Rotation.from_rotvec(rng.normal(0, 0.1, 3))
    X = from_rotation_vector(rng.uniform(-0.08, 0.08, 3) + [0, 0, 0.05], turn.as_rotvec())
    # The z axis of the board points into the table.
    face_up = Rotation.from_euler("xz", [np.pi, rng.uniform(-np.pi, np.pi)])
    Y = from_rotation_vector([rng.uniform(0.35, 0.6), rng.uniform(-0.3, 0.3), 0.01], face_up.as_rotvec())
    return X, Y


def _to_hand(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return X and Y of a camera above the cell that looks down, and of a board on the flange."""
    down = Rotation.from_euler("xz", [np.pi, rng.uniform(-np.pi, np.pi)]) * Rotation.from_rotvec(rng.normal(0, 0.1, 3))
    X = from_rotation_vector([rng.uniform(0.35, 0.6), rng.uniform(-0.3, 0.3), 1.0], down.as_rotvec())
    turn = Rotation.from_rotvec(rng.normal(0, 0.1, 3)) * Rotation.from_euler("xz", [np.pi, rng.uniform(-np.pi, np.pi)])
    Y = from_rotation_vector(rng.uniform(-0.08, 0.08, 3) + [0, 0, 0.05], turn.as_rotvec())
    return X, Y


def _seen(T_camera_board: NDArray[np.float64], board: Board, scale: float):
    """Return the numbers (N,) and exact pixels (N, 2) of the corners within the image."""
    points = scale * board.points @ T_camera_board[:3, :3].T + T_camera_board[:3, 3]
    pixels = points[:, :2] / points[:, 2:] * [K[0, 0], K[1, 1]] + K[:2, 2]
    inside = (points[:, 2] > 0) & (pixels > 8).all(axis=1) & (pixels < np.array(IMAGE) - 9).all(axis=1)
    return np.flatnonzero(inside), pixels[inside]
