"""Calibration board on the simulated table: its pose, its plate, and its print as a camera sees it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from calibration.target.board import Board
from calibration.target.rendering import render_board
from cell.simulation.scenes.clutter import Box

THICKNESS_M = 0.003
"""Thickness of the plate."""
MARGIN_PITCHES = 1.0
"""White margin around the print, in pitches."""
ASIDE_M = 0.03
"""Largest distance of the board's middle from the origin of the scene, along x and along y."""
YAW_RAD = float(np.deg2rad(40.0))
"""Largest rotation of the board in both directions."""
SAMPLES = 4
"""Number of samples of the print per pixel and axis."""
FINEST = 256
"""Largest number of pixels per pitch in an image of the print."""


def lay_board(board: Board, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return `T_scene_board` (4, 4) of a board on the table z = 0, print up, near the middle and slightly rotated."""
    yaw = rng.uniform(-YAW_RAD, YAW_RAD)
    middle = np.append(rng.uniform(-ASIDE_M, ASIDE_M, 2), THICKNESS_M)
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    # seen from above, x points right and y down, so z points away from the viewer
    T[:3, :3] = [[c, s, 0], [s, -c, 0], [0, 0, -1]]
    T[:3, 3] = middle - T[:3, :2] @ _middle(board)
    return T


def plate(board: Board, T_scene_board: NDArray[np.float64]) -> Box:
    """Return the plate of the board, with the margin around the print."""
    x, y = T_scene_board[:2, :2] @ _middle(board) + T_scene_board[:2, 3]
    width, height = (side + 2 * MARGIN_PITCHES * board.pitch_m for side in board.size_m)
    yaw = float(np.arctan2(T_scene_board[1, 0], T_scene_board[0, 0]))
    return Box((float(x), float(y)), (width, height, THICKNESS_M), yaw)


@dataclass(frozen=True, eq=False)
class SeenPrint:
    """A part of an image, with the share of the print in each pixel."""

    rows: slice
    columns: slice
    white: NDArray[np.float32]
    """Share (h, w) of each pixel that is unprinted paper."""
    black: NDArray[np.float32]
    """Share (h, w) of each pixel that is printed. The rest is not the board."""


class Print:
    """The print of a board, for perspective views."""

    def __init__(self, board: Board, T_scene_board: NDArray[np.float64]) -> None:
        """Create the print. Its images are made when a view needs them, at the resolution that the view needs."""
        self.board = board
        """Printed board."""
        self.T_scene_board = T_scene_board
        """(4, 4) pose of the board in the scene."""
        self._pictures: dict[int, tuple[NDArray[np.uint8], NDArray[np.float64]]] = {}

    def seen(
        self, T_scene_camera: NDArray[np.float64], K: NDArray[np.float64], on_plate: NDArray[np.bool_]
    ) -> SeenPrint:
        """Return the print in the view of a pinhole camera.

        Each pixel is the mean of 4 x 4 samples, which have about the size of a pixel of the print's image.

        Args:
            T_scene_camera: Camera pose (4, 4) in the scene.
            K: Pinhole matrix (3, 3), pixels.
            on_plate: Pixels (H, W) whose centre shows the plate, at least one.
        """
        import cv2

        v, u = (np.flatnonzero(on_plate.any(axis=axis)) for axis in (1, 0))
        # one pixel more on each side, because the centre of a pixel at the edge may miss the plate
        rows = slice(max(int(v[0]) - 1, 0), min(int(v[-1]) + 2, on_plate.shape[0]))
        columns = slice(max(int(u[0]) - 1, 0), min(int(u[-1]) + 2, on_plate.shape[1]))
        size = np.array([columns.stop - columns.start, rows.stop - rows.start])
        H_image_board = K @ (inverse(T_scene_camera) @ self.T_scene_board)[:3, [0, 1, 3]]
        pixels, H_picture_board = self._picture(SAMPLES * _pixels_per_m(H_image_board, _middle(self.board)))
        # integer coordinates are centres of pixels and of samples; the first sample is before the centre of its pixel
        first = np.array([columns.start, rows.start]) + 0.5 / SAMPLES - 0.5
        H_image_sample = np.array([[1 / SAMPLES, 0, first[0]], [0, 1 / SAMPLES, first[1]], [0, 0, 1]])
        samples = cv2.warpPerspective(
            pixels,
            H_picture_board @ np.linalg.inv(H_image_board) @ H_image_sample,
            (SAMPLES * size).tolist(),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
        )
        mean = cv2.resize(samples, size.tolist(), interpolation=cv2.INTER_AREA).astype(np.float32) * np.float32(1 / 255)
        return SeenPrint(rows, columns, white=mean[..., 0], black=mean[..., 1])

    def _picture(self, pixels_per_m: float) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Return an image (h, w, 2) of the print, and the map from board points to its pixels.

        The image has a white and a black channel and at least the given resolution.
        """
        least = pixels_per_m * self.board.pitch_m
        per_pitch = min(2 ** max(int(np.ceil(np.log2(least))), 0), FINEST)
        if per_pitch not in self._pictures:
            picture = render_board(self.board, per_pitch, MARGIN_PITCHES)
            scale, (x, y) = picture.pixels_per_m, picture.origin_px
            H_picture_board = np.array([[scale, 0, x], [0, scale, y], [0, 0, 1]])
            self._pictures[per_pitch] = np.dstack([picture.pixels, 255 - picture.pixels]), H_picture_board
        return self._pictures[per_pitch]


def _middle(board: Board) -> NDArray[np.float64]:
    """Return the middle (2,) of the print, board frame."""
    return np.array(board.print_corner) + np.array(board.size_m) / 2


def _pixels_per_m(H_image_board: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Return the image resolution at a point of the board, pixels per metre, in the direction with the most pixels."""
    x, y, w = H_image_board @ (*point, 1.0)
    derivative = (H_image_board[:2, :2] - np.outer((x / w, y / w), H_image_board[2, :2])) / w
    return float(np.linalg.norm(derivative, 2))
