"""A calibration board that lies on the simulated table: where, its plate, and its print as a camera sees it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from calibration.target.board import Board
from calibration.target.rendering import render_board
from cell.simulation.scenes.clutter import Box

THICKNESS_M = 0.003
"""Of the plate that the board is printed on."""
MARGIN_PITCHES = 1.0
"""White around what is printed."""
ASIDE_M = 0.03
"""Its middle lies at most so far from the scene's origin, along x and along y."""
YAW_RAD = float(np.deg2rad(40.0))
"""Turned by at most so much to either side."""
SAMPLES = 4
"""Of the print, per pixel and axis."""
FINEST = 256
"""Most pixels to a pitch of the print's own pictures."""


def lay_board(board: Board, rng: np.random.Generator) -> NDArray[np.float64]:
    """`T_scene_board` (4, 4) of a board that lies on the table z = 0, print up, near the middle and a little turned."""
    yaw = rng.uniform(-YAW_RAD, YAW_RAD)
    middle = np.append(rng.uniform(-ASIDE_M, ASIDE_M, 2), THICKNESS_M)
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    # Seen from above, x goes to the right and y down: z points away from whoever looks.
    T[:3, :3] = [[c, s, 0], [s, -c, 0], [0, 0, -1]]
    T[:3, 3] = middle - T[:3, :2] @ _middle(board)
    return T


def plate(board: Board, T_scene_board: NDArray[np.float64]) -> Box:
    """The board as a body: print and margin, with a thickness."""
    x, y = T_scene_board[:2, :2] @ _middle(board) + T_scene_board[:2, 3]
    width, height = (side + 2 * MARGIN_PITCHES * board.pitch_m for side in board.size_m)
    yaw = float(np.arctan2(T_scene_board[1, 0], T_scene_board[0, 0]))
    return Box((float(x), float(y)), (width, height, THICKNESS_M), yaw)


@dataclass(frozen=True, eq=False)
class SeenPrint:
    """A part of an image, and what of a print there is in its pixels."""

    rows: slice
    columns: slice
    white: NDArray[np.float32]
    """(h, w) share of each pixel that is unprinted paper."""
    black: NDArray[np.float32]
    """(h, w) share of each pixel that is printed; what is left is not the board."""


class Print:
    """What is printed on a board, for views of it in perspective."""

    def __init__(self, board: Board, T_scene_board: NDArray[np.float64]) -> None:
        """Pictures of the print are made only when a view needs them, as finely as it needs them."""
        self._board, self._T_scene_board = board, T_scene_board
        self._pictures: dict[int, tuple[NDArray[np.uint8], NDArray[np.float64]]] = {}

    def seen(
        self, T_scene_camera: NDArray[np.float64], K: NDArray[np.float64], on_plate: NDArray[np.bool_]
    ) -> SeenPrint:
        """The print in the view of a pinhole camera.

        `on_plate` (H, W) tells which pixels look at the plate by their middles; there must be some. Each pixel is the
        mean of 4 x 4 samples, which have about the size of the pixels of the print's picture: nothing falls between.
        """
        import cv2

        v, u = (np.flatnonzero(on_plate.any(axis=axis)) for axis in (1, 0))
        # A pixel more on each side: the middle of one at the rim may look past the plate.
        rows = slice(max(int(v[0]) - 1, 0), min(int(v[-1]) + 2, on_plate.shape[0]))
        columns = slice(max(int(u[0]) - 1, 0), min(int(u[-1]) + 2, on_plate.shape[1]))
        size = np.array([columns.stop - columns.start, rows.stop - rows.start])
        H_image_board = K @ (inverse(T_scene_camera) @ self._T_scene_board)[:3, [0, 1, 3]]
        pixels, H_picture_board = self._picture(SAMPLES * _pixels_per_m(H_image_board, _middle(self._board)))
        # Whole coordinates are the middles of pixels, and of samples: the first sample lies before its pixel's middle.
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
        """The print (h, w, 2), its white and its black, at least so fine, and where a point of the board is in it."""
        least = pixels_per_m * self._board.pitch_m
        per_pitch = min(2 ** max(int(np.ceil(np.log2(least))), 0), FINEST)
        if per_pitch not in self._pictures:
            picture = render_board(self._board, per_pitch, MARGIN_PITCHES)
            scale, (x, y) = picture.pixels_per_m, picture.origin_px
            H_picture_board = np.array([[scale, 0, x], [0, scale, y], [0, 0, 1]])
            self._pictures[per_pitch] = np.dstack([picture.pixels, 255 - picture.pixels]), H_picture_board
        return self._pictures[per_pitch]


def _middle(board: Board) -> NDArray[np.float64]:
    """(2,) the middle of what is printed, board frame."""
    return np.array(board.print_corner) + np.array(board.size_m) / 2


def _pixels_per_m(H_image_board: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """How many pixels the image has for a metre of the board there, in the direction in which it has most."""
    x, y, w = H_image_board @ (*point, 1.0)
    derivative = (H_image_board[:2, :2] - np.outer((x / w, y / w), H_image_board[2, :2])) / w
    return float(np.linalg.norm(derivative, 2))
