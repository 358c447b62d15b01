"""Checkerboards and circle grids: accuracy of the corners, and uniqueness of the numbering."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.errors import BoardNotSeenError
from calibration.target.board import Board
from calibration.target.corner_ordering import symmetric_numberings
from calibration.target.detection import DetectedBoard, detect_board
from calibration.target.rendering import DOT_DIAMETERS
from tests.calibration.rendered_board import K_640, K_1280, board_before_camera, render, true_pixels

pytestmark = pytest.mark.slow


def sight(
    board: Board,
    roll_deg: float,
    *,
    K: NDArray[np.float64] = K_640,
    distance_m: float = 0.45,
    dots: tuple[float, float] = DOT_DIAMETERS,
) -> tuple[DetectedBoard, NDArray[np.float64]]:
    """Return the detected board of an image and the true pixels (N, 2) of all corners."""
    T = board_before_camera(board, distance_m, 28.0, tilt_axis_deg=50.0, roll_deg=roll_deg)
    image = render(board, T, K, np.random.default_rng(3), dots=dots)
    return detect_board(image, board), true_pixels(board, T, K)


def off_px(sighting: DetectedBoard, truth: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(sighting.pixels - truth[sighting.ids], axis=1).max())


@pytest.mark.parametrize("roll_deg", [0.0, 80.0, 170.0, 260.0])
@pytest.mark.parametrize(
    "board",
    [
        Board("checkerboard", 10, 7, 0.025),
        Board("checkerboard", 7, 8, 0.025),
        Board("circles", 10, 8, 0.02),
        Board("circles", 9, 9, 0.02),
    ],
    ids=str,
)
def test_a_unique_numbering_is_detected(board: Board, roll_deg: float):
    sighting, truth = sight(board, roll_deg)
    assert sighting.is_numbering_unique
    assert sighting.ids.tolist() == list(range(len(truth)))
    assert off_px(sighting, truth) <= 0.12
    assert sighting.corner_sigma_px is not None
    assert sighting.corner_sigma_px <= 0.04


@pytest.mark.parametrize("roll_deg", [0.0, 80.0, 170.0, 260.0])
@pytest.mark.parametrize(
    ("board", "ways"),
    [
        (Board("checkerboard", 9, 7, 0.025), 2),
        (Board("checkerboard", 8, 8, 0.025), 2),
        (Board("checkerboard", 7, 7, 0.025), 4),
        (Board("circles", 10, 8, 0.02), 2),
        (Board("circles", 8, 8, 0.02), 4),
    ],
    ids=str,
)
def test_an_ambiguous_numbering_is_one_of_the_allowed(board: Board, ways: int, roll_deg: float):
    sighting, truth = sight(board, roll_deg, dots=(DOT_DIAMETERS[0], DOT_DIAMETERS[0]))
    assert not sighting.is_numbering_unique
    assert len(sighting.ids) == len(truth)
    numberings = symmetric_numberings(board)
    assert len(numberings) == ways
    errors = sorted(off_px(sighting, truth[numbering]) for numbering in numberings)
    # One numbering is right, and the others are off by the size of the board.
    assert errors[0] <= 0.12
    assert errors[1] > 50.0


@pytest.mark.parametrize(
    ("board", "ways"),
    [
        (Board(), 1),
        (Board("checkerboard", 10, 7, 0.025), 1),
        (Board("checkerboard", 10, 8, 0.025), 2),
        (Board("checkerboard", 10, 10, 0.025), 2),
        (Board("checkerboard", 11, 11, 0.025), 4),
        (Board("circles", 10, 10, 0.02), 4),
    ],
    ids=str,
)
def test_symmetric_numberings_map_the_board_to_itself(board: Board, ways: int):
    numberings = symmetric_numberings(board)
    assert len(numberings) == ways
    assert numberings[0].tolist() == list(range(len(board.points)))
    middle = board.points.mean(axis=0)
    for numbering in numberings:
        assert sorted(numbering) == list(range(len(board.points)))
        before, after = (board.points - middle)[:, :2], (board.points[numbering] - middle)[:, :2]
        turn = np.linalg.lstsq(before, after, rcond=None)[0]
        np.testing.assert_allclose(before @ turn, after, atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(2), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)


@pytest.mark.parametrize("dots", [(0.4, 0.7), (0.6, 0.9), (0.5, 1.0)])
def test_dots_of_any_size_are_detected_at_their_centre(dots: tuple[float, float]):
    # With this perspective, the centroids are off by up to 0.2 px (by 0.5 px for the first dot).
    board = Board("circles", 9, 7, 0.025)
    sighting, truth = sight(board, 20.0, K=K_1280, distance_m=0.36, dots=dots)
    assert sighting.is_numbering_unique
    assert len(sighting.ids) == len(truth)
    assert off_px(sighting, truth) <= 0.15


def test_swapped_columns_and_rows_are_reported():
    board = Board("circles", 10, 8, 0.02)
    T = board_before_camera(board, 0.45, 20.0)
    image = render(board, T, K_640, np.random.default_rng(0))
    for wrong, shown in ((Board("circles", 8, 10, 0.02), image), (board, image[:, ::-1])):
        with pytest.raises(
            BoardNotSeenError, match=r"larger dot of the circle grid is not at .* check that the image is not mirrored"
        ):
            detect_board(shown, wrong)


@pytest.mark.parametrize("board", [Board("checkerboard", 10, 7, 0.025), Board("circles", 10, 8, 0.02)], ids=str)
def test_a_grid_must_be_completely_in_the_image(board: Board):
    T = board_before_camera(board, 0.36, 20.0, aside_m=(0.25, 0.0))
    with pytest.raises(BoardNotSeenError, match="needs all of its"):
        detect_board(render(board, T, K_640, np.random.default_rng(0)), board)


def test_other_dots_around_a_grid_are_ignored():
    board = Board("circles", 8, 6, 0.02)
    T = board_before_camera(board, 0.45, 20.0)
    image = render(board, T, K_640, np.random.default_rng(0))
    y, x = np.mgrid[:400, :640]
    for place in ((40, 60), (600, 350), (90, 330), (560, 50), (320, 20)):
        image[(x - place[0]) ** 2 + (y - place[1]) ** 2 < 36] = 20
    sighting = detect_board(image, board)
    assert sighting.is_numbering_unique
    assert off_px(sighting, true_pixels(board, T, K_640)) <= 0.12
