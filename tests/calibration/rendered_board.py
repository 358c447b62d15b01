"""Rendered images of a board. Each pixel is the mean over its area, with blur and noise."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, transform_points
from calibration.target.board import Board
from calibration.target.rendering import DOT_DIAMETERS, BoardImage, render_board

K_1280 = np.array([[763.0, 0.0, 639.5], [0.0, 763.0, 399.5], [0.0, 0.0, 1.0]])
"""Camera matrix (3, 3) for 1280 x 800 pixels."""
K_640 = np.array([[402.0, 0.0, 319.5], [0.0, 402.0, 199.5], [0.0, 0.0, 1.0]])
"""Camera matrix (3, 3) for 640 x 400 pixels."""
SAMPLES = 4
"""Samples per pixel and axis."""
TEXTURE = 128
"""Texture pixels of the board per pitch."""


@dataclass(frozen=True)
class Light:
    """Light, blur and noise of an image."""

    black: float = 30.0
    white: float = 215.0
    table: float = 110.0
    falloff: float = 0.25
    """Share by which the corner of the image is darker than its middle."""
    blur_px: float = 0.6
    """Standard deviation of the blur of the lens, pixels."""
    noise: float = 2.0
    """Standard deviation of the noise of the sensor, grey levels."""


@lru_cache(maxsize=32)
def _picture(board: Board, margin_pitches: float, dots: tuple[float, float]) -> BoardImage:
    return render_board(board, TEXTURE, margin_pitches, dots)


def image_size(K: NDArray[np.float64]) -> tuple[int, int]:
    """Return width and height of the image of a camera with the principal point in the middle."""
    return round(2 * K[0, 2] + 1), round(2 * K[1, 2] + 1)


def board_before_camera(
    board: Board,
    distance_m: float,
    tilt_deg: float,
    tilt_axis_deg: float = 0.0,
    roll_deg: float = 0.0,
    aside_m: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:
    """Return `T_camera_board` (4, 4).

    The centre of the board is at `aside_m` and `distance_m`. The board is rolled about the line of sight, then tilted
    about an axis in the image plane.
    """
    axis = np.array([np.cos(np.radians(tilt_axis_deg)), np.sin(np.radians(tilt_axis_deg)), 0.0])
    tilted = from_rotation_vector((*aside_m, distance_m), np.radians(tilt_deg) * axis)
    rolled = from_rotation_vector((0.0, 0.0, 0.0), (0.0, 0.0, np.radians(roll_deg)))
    middle = np.eye(4)
    middle[:3, 3] = -board.points.mean(axis=0)
    return tilted @ rolled @ middle


def true_pixels(board: Board, T_camera_board: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the true pixels (N, 2) of all corners of the board, inside or outside the image."""
    seen = transform_points(T_camera_board, board.points) @ K.T
    return seen[:, :2] / seen[:, 2:]


def render(
    board: Board,
    T_camera_board: NDArray[np.float64],
    K: NDArray[np.float64],
    rng: np.random.Generator,
    light: Light | None = None,
    margin_pitches: float = 0.7,
    dots: tuple[float, float] = DOT_DIAMETERS,
) -> NDArray[np.uint8]:
    """Return the image (H, W) of a board with a white margin on a grey table."""
    light = light or Light()
    width, height = image_size(K)
    picture = _picture(board, margin_pitches, dots)
    scale, (u0, v0) = picture.pixels_per_m, picture.origin_px
    board_of_texture = np.array([[1 / scale, 0, -u0 / scale], [0, 1 / scale, -v0 / scale], [0, 0, 1]])
    image_of_texture = K @ T_camera_board[:3, [0, 1, 3]] @ board_of_texture
    # Only the pixels of the paper are sampled, because fine sampling needs much memory.
    rows, columns = picture.pixels.shape
    corners = np.array([[0, 0, 1], [columns, 0, 1], [columns, rows, 1], [0, rows, 1]]) @ image_of_texture.T
    corners = corners[:, :2] / corners[:, 2:]
    left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 3, [width, height])
    # The centre of the pixel (left, top) is the mean of the centres of its samples.
    shift = (SAMPLES - 1) / 2 - SAMPLES * np.array([left, top])
    fine_of_image = np.array([[SAMPLES, 0, shift[0]], [0, SAMPLES, shift[1]], [0, 0, 1.0]])
    fine = cv2.warpPerspective(
        np.round(light.black + (light.white - light.black) * picture.pixels / 255.0).astype(np.uint8),
        fine_of_image @ image_of_texture,
        (int(right - left) * SAMPLES, int(bottom - top) * SAMPLES),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=light.table,
    )
    image = np.full((height, width), light.table, dtype=np.float32)
    part = image[top:bottom, left:right]
    part[:] = cv2.resize(fine.astype(np.float32), part.shape[::-1], interpolation=cv2.INTER_AREA)
    if light.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), light.blur_px)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    image = image * (1.0 - light.falloff * (x**2 + y**2) / 2) + rng.normal(0.0, light.noise, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
