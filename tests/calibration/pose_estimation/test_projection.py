"""Undistortion is exact, also at the edge of an image with strong lens distortion."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.observations import BoardView, Observations
from calibration.pose_estimation.projection import stack_corners
from calibration.target.board import Board

BOARD = Board(kind="checkerboard", columns=41, rows=27, pitch_m=0.02)


@pytest.mark.parametrize(
    ("focal", "distortion"),
    [
        (800.0, [-0.12, 0.05, 4e-4, -3e-4, 0.0]),
        (800.0, [-0.3, 0.1, 0.0, 0.0]),
        (400.0, [-0.3, 0.08, 0.0, 0.0]),
        (600.0, [5.2, 3.1, 0.0, 0.0, 0.15, 5.5, 4.6, 0.8]),
    ],
)
def test_distortion_inverts_undistortion(focal: float, distortion: list[float]) -> None:
    import cv2

    K = np.array([[focal, 0.0, 639.5], [0.0, focal, 399.5], [0.0, 0.0, 1.0]])
    u, v = np.meshgrid(np.linspace(0, 1279, BOARD.columns - 1), np.linspace(0, 799, BOARD.rows - 1))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    view = BoardView("all over", np.eye(4), np.arange(len(pixels)), pixels)
    observations = Observations(BOARD, K, (1280, 800), (view,), np.array(distortion))
    straight = stack_corners(observations).pixels[0]
    rays = np.column_stack([(straight - K[:2, 2]) / focal, np.ones(len(straight))])
    again = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array(distortion))[0].reshape(-1, 2)
    assert np.abs(again - pixels).max() < 1e-6
    assert np.abs(straight - pixels).max() > 10.0
    np.testing.assert_array_equal(stack_corners(replace(observations, distortion=np.zeros(5))).pixels[0], pixels)
