"""The rendered image of a board equals the print."""

import cv2
import numpy as np
import pytest

from calibration.target.board import Board
from calibration.target.rendering import DOT_DIAMETERS, board_shapes, render_board


def opencv_picture(board: Board, pixels_per_pitch: int) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    opencv = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    size = board.columns * pixels_per_pitch, board.rows * pixels_per_pitch
    return opencv.generateImage(size, marginSize=0)


@pytest.mark.parametrize(
    ("board", "pixels"),
    [(Board(pitch_m=0.025, marker_m=0.018), 50), (Board("charuco", 8, 5, 0.04, 0.028, "DICT_5X5_100"), 40)],
    ids=str,
)
def test_a_charuco_board_with_edges_between_pixels_equals_that_of_opencv(board: Board, pixels: int):
    picture = render_board(board, pixels, margin_pitches=1.0)
    assert np.array_equal(picture.pixels[pixels:-pixels, pixels:-pixels], opencv_picture(board, pixels))
    margin = picture.pixels.copy()
    margin[pixels:-pixels, pixels:-pixels] = 255
    assert (margin == 255).all()


@pytest.mark.parametrize("board", [Board(), Board("checkerboard", 6, 5, 0.03), Board("circles", 6, 5, 0.02)], ids=str)
@pytest.mark.parametrize("pixels", [17, 24])
def test_the_printed_area_is_that_of_the_shapes(board: Board, pixels: int):
    picture = render_board(board, pixels, margin_pitches=0.3)
    shapes = board_shapes(board)
    x0, y0, x1, y1 = shapes.rectangles.T
    area = ((x1 - x0) * (y1 - y0)).sum() + np.pi * (shapes.discs[:, 2] ** 2).sum()
    ink = (255.0 - picture.pixels).sum() / 255.0 / picture.pixels_per_m**2
    # Grey levels are rounded to 1/255, and the edges of discs to 1/16 pixel.
    assert ink == pytest.approx(area, rel=2e-3)


def test_the_origin_is_at_the_first_corner():
    board = Board("checkerboard", 5, 4, 0.03)
    picture = render_board(board, 20, margin_pitches=0.5)
    assert picture.pixels.shape == (100, 120)
    # Between the pixels 29 and 30. The first two of the four squares around a corner are black and white.
    assert picture.origin_px == (29.5, 29.5)
    assert picture.pixels[29:31, 29:31].tolist() == [[0, 255], [255, 0]]
    far = picture.origin_px + picture.pixels_per_m * board.points[-1, :2]
    assert far.tolist() == [89.5, 69.5]


def test_the_first_dot_is_larger():
    board = Board("circles", 4, 3, 0.02)
    picture = render_board(board, 40, margin_pitches=0.5)
    for number, point in enumerate(board.points):
        x, y = np.round(picture.origin_px + picture.pixels_per_m * point[:2]).astype(int)
        diameter = (picture.pixels[y, x - 20 : x + 20] < 128).sum() / 40
        assert diameter == pytest.approx(DOT_DIAMETERS[number == 0], abs=0.03)  # a pixel is 0.025


def test_an_image_without_pixels_is_rejected():
    with pytest.raises(ValueError, match="no image has"):
        render_board(Board(), 0)
    with pytest.raises(ValueError, match="no image has"):
        render_board(Board(), 10, margin_pitches=-1.0)
