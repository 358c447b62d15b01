"""Detection of boards in rendered images: numbers, pixels and accuracy of the corners."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.errors import BoardDetectionError, BoardImageError, BoardMirroredError, BoardNotSeenError
from calibration.geometry.transforms import transform_points
from calibration.target.board import Board
from calibration.target.detection import detect_board
from tests.calibration.rendered_board import K_640, K_1280, Light, board_before_camera, image_size, render, true_pixels

pytestmark = pytest.mark.slow

CHARUCO = Board()


def picture(
    board: Board = CHARUCO, distance_m: float = 0.4, tilt_deg: float = 25.0, roll_deg: float = 40.0, **light: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return an image of 640 x 400 pixels and the true pixels (N, 2) of all corners of the board."""
    T = board_before_camera(board, distance_m, tilt_deg, tilt_axis_deg=70.0, roll_deg=roll_deg)
    return render(board, T, K_640, np.random.default_rng(7), Light(**light)), true_pixels(board, T, K_640)


@pytest.mark.parametrize(("K", "distances"), [(K_1280, (0.27, 0.4)), (K_640, (0.36, 0.6))], ids=["1280x800", "640x400"])
def test_corners_of_fifteen_image_files_are_exact(K: NDArray[np.float64], distances: tuple[float, ...], tmp_path: Path):
    rng = np.random.default_rng(1)
    possible, errors = 0, []
    for view in range(15):
        distance = distances[view % len(distances)]
        T = board_before_camera(CHARUCO, distance, rng.uniform(15, 30), rng.uniform(0, 360), rng.uniform(-75, 75))
        assert cv2.imwrite(str(tmp_path / f"{view}.png"), render(CHARUCO, T, K, rng))
        truth = true_pixels(CHARUCO, T, K)
        possible += int(((truth >= 3) & (truth <= np.array(image_size(K)) - 4)).all(axis=1).sum())
        image = np.asarray(cv2.imread(str(tmp_path / f"{view}.png")), dtype=np.uint8)
        sighting = detect_board(image, CHARUCO)
        assert sighting.is_numbering_unique
        errors.append(sighting.pixels - truth[sighting.ids])
    found = np.vstack(errors)
    assert len(found) >= 0.99 * possible
    # The requirement is 0.1 px; the detector reaches 0.02 px.
    assert np.sqrt((found**2).sum(axis=1).mean()) <= 0.04
    assert np.abs(found).max() <= 0.15


@pytest.mark.parametrize(
    "light",
    [{"blur_px": 1.5}, {"blur_px": 0.3}, {"noise": 8.0}, {"black": 8.0, "white": 50.0, "table": 30.0}],
    ids=["out of focus", "sharp", "noisy", "dim"],
)
def test_corners_are_detected_in_poor_light(light: dict[str, float]):
    image, truth = picture(CHARUCO, **light)
    sighting = detect_board(image, CHARUCO)
    assert len(sighting.ids) == len(truth)
    assert np.linalg.norm(sighting.pixels - truth, axis=1).max() <= 0.15


def test_hidden_corners_do_not_shift_others():
    image, truth = picture(distance_m=0.36)
    for start, end in pairwise(truth[[3, 20, 47]]):
        cv2.line(image, start.astype(int).tolist(), end.astype(int).tolist(), 230, 9, cv2.LINE_AA)
    sighting = detect_board(image, CHARUCO)
    assert 24 <= len(sighting.ids) < len(truth)
    assert not {3, 20, 47} & set(sighting.ids.tolist())
    assert np.linalg.norm(sighting.pixels - truth[sighting.ids], axis=1).max() <= 0.15


def test_part_of_a_charuco_board_is_sufficient():
    T = board_before_camera(CHARUCO, 0.36, 20.0, aside_m=(0.29, 0.12))
    truth = true_pixels(CHARUCO, T, K_640)
    sighting = detect_board(render(CHARUCO, T, K_640, np.random.default_rng(0)), CHARUCO)
    inside = ((truth >= 4) & (truth <= np.array(image_size(K_640)) - 5)).all(axis=1)
    assert 6 <= inside.sum() < len(truth) / 2
    assert set(np.flatnonzero(inside)) <= set(sighting.ids.tolist())
    assert np.linalg.norm(sighting.pixels - truth[sighting.ids], axis=1).max() <= 0.15


def test_corners_are_detected_with_lens_distortion():
    distortion = np.array([-0.2, 0.02, 0.001, -0.001])
    T = board_before_camera(CHARUCO, 0.36, 20.0, roll_deg=30.0)
    image = render(CHARUCO, T, K_640, np.random.default_rng(0))
    width, height = image_size(K_640)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(pixels, K_640, distortion, P=K_640).reshape(height, width, 2).astype(np.float32)
    bent = cv2.remap(image, straight[..., 0], straight[..., 1], cv2.INTER_CUBIC)
    truth = cv2.projectPoints(transform_points(T, CHARUCO.points), np.zeros(3), np.zeros(3), K_640, distortion)[0][:, 0]
    sighting = detect_board(np.asarray(bent, dtype=np.uint8), CHARUCO)
    assert len(sighting.ids) >= 46
    assert np.linalg.norm(sighting.pixels - truth[sighting.ids], axis=1).max() <= 0.2


def test_a_wrong_marker_size_shifts_corners_little():
    printed = Board(marker_m=0.019)
    image, truth = picture(printed)
    sighting = detect_board(image, CHARUCO)
    assert len(sighting.ids) == len(truth)
    assert np.sqrt(((sighting.pixels - truth) ** 2).sum(axis=1).mean()) <= 0.1


@pytest.mark.parametrize("noise", [1.0, 8.0, 20.0])
def test_sigma_is_the_error_of_a_coordinate(noise: float):
    sigmas, errors = [], []
    for roll in (0.0, 30.0, 60.0):
        image, truth = picture(roll_deg=roll, noise=noise)
        sighting = detect_board(image, CHARUCO)
        assert sighting.corner_sigma_px is not None
        sigmas.append(sighting.corner_sigma_px)
        errors.append(sighting.pixels - truth[sighting.ids])
    rms = np.sqrt(np.mean(np.vstack(errors) ** 2))
    # The median of 96 values has an error of 10 % at three times its sigma, and the cubic fit removes some noise.
    assert 0.65 <= np.median(sigmas) / rms <= 1.35


def test_no_sigma_from_few_corners():
    board = Board("charuco", 5, 3, 0.04, 0.03)
    image, _ = picture(board)
    sighting = detect_board(image, board)
    assert len(sighting.ids) == 8
    assert sighting.corner_sigma_px is None


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_image_is_reported(axis: int):
    image, _ = picture()
    with pytest.raises(BoardMirroredError, match="switch off the camera's flip or mirror") as error:
        detect_board(np.flip(image, axis), CHARUCO)
    assert error.value.slug == "board-mirrored"


def test_an_upside_down_image_is_not_mirrored():
    image, truth = picture()
    sighting = detect_board(np.rot90(image, 2), CHARUCO)
    turned = np.array([image.shape[1], image.shape[0]]) - 1 - truth
    assert np.linalg.norm(sighting.pixels - turned[sighting.ids], axis=1).max() <= 0.15


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (CHARUCO, "nor any of its markers"),
        (Board("checkerboard", 10, 7, 0.025), "all of its 10 x 7 squares"),
        (Board("circles", 10, 8, 0.02), "all of its 10 x 8 dots"),
    ],
    ids=str,
)
def test_an_image_without_a_board_is_reported(board: Board, words: str):
    image = np.clip(np.random.default_rng(0).normal(12.0, 5.0, (400, 640)), 0, 255).astype(np.uint8)
    with pytest.raises(BoardNotSeenError) as error:
        detect_board(image, board)
    assert words in str(error.value)
    assert "dark, its median grey level is 12 of 255" in str(error.value)
    assert error.value.slug == "board-not-seen"


@pytest.mark.parametrize(
    "other", [Board(dictionary="DICT_5X5_50"), Board("charuco", 7, 5, 0.036, 0.027), Board("checkerboard", 9, 7, 0.026)]
)
def test_another_board_is_not_detected(other: Board):
    image, _ = picture(other)
    with pytest.raises(BoardNotSeenError, match="check that it is charuco 9 x 7"):
        detect_board(image, CHARUCO)


def test_corners_on_a_line_are_rejected():
    image, truth = picture(roll_deg=0.0, tilt_deg=0.0)
    below = int((truth[:8, 1].mean() + truth[8:16, 1].mean()) / 2)
    image[below + 3 :] = 110
    with pytest.raises(BoardNotSeenError, match=r"the 8 visible corners .* lie on a line"):
        detect_board(image, CHARUCO)


def test_too_few_corners_are_rejected():
    image, truth = picture(roll_deg=0.0, tilt_deg=0.0)
    below, right = ((truth[0] + truth[9 + 8 * 1]) / 2).astype(int)[::-1] + 16
    image[below:] = 110
    image[:, right:] = 110
    with pytest.raises(BoardNotSeenError, match=r"only 4 corners .* 6 are needed"):
        detect_board(image, CHARUCO)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((400, 640), dtype=np.uint16), "type uint16"),
        (np.zeros((400, 640), dtype=np.float64), "type float64"),
        (np.zeros((400, 640, 4), dtype=np.uint8), "shape (400, 640, 4)"),
        (np.zeros((640,), dtype=np.uint8), "shape (640,)"),
        (np.zeros((0, 640), dtype=np.uint8), "shape (0, 640)"),
        ("image.png", "a str"),
    ],
)
def test_arrays_that_are_not_images_are_rejected(image: NDArray[np.uint8], words: str):
    with pytest.raises(BoardImageError) as error:
        detect_board(image, CHARUCO)
    assert words in str(error.value)
    assert isinstance(error.value, BoardDetectionError)


@pytest.mark.parametrize("shape", [(1, 1), (3, 640), (400, 2), (20, 20)])
@pytest.mark.parametrize(
    "board", [CHARUCO, Board("checkerboard", 10, 7, 0.025), Board("circles", 10, 8, 0.02)], ids=str
)
def test_tiny_images_show_no_board(shape: tuple[int, int], board: Board):
    with pytest.raises(BoardNotSeenError):
        detect_board(np.full(shape, 128, dtype=np.uint8), board)


def test_colour_images_and_array_views_are_accepted():
    image, truth = picture()
    colour = np.repeat(image[:, :, None], 3, axis=2)
    wide = np.zeros((400, 1280), dtype=np.uint8)
    wide[:, ::2] = image
    for form in (colour, image[:, :, None], wide[:, ::2]):
        sighting = detect_board(form, CHARUCO)
        assert np.linalg.norm(sighting.pixels - truth[sighting.ids], axis=1).max() <= 0.15


@pytest.mark.parametrize("counts", [(8, 7), (8, 8), (10, 9), (9, 7), (9, 9), (7, 8)], ids=str)
@pytest.mark.parametrize("K", [K_640, K_1280], ids=["640x400", "1280x800"])
def test_a_checkerboard_with_other_counts_is_described(counts: tuple[int, int], K: NDArray[np.float64]):
    visible = Board(kind="checkerboard", columns=9, rows=8, pitch_m=0.02)
    T = board_before_camera(visible, 0.4, 25.0, 70.0, 40.0)
    image = render(visible, T, K, np.random.default_rng(7))
    with pytest.raises(BoardNotSeenError) as raised:
        detect_board(image, Board(kind="checkerboard", columns=counts[0], rows=counts[1], pitch_m=0.02))
    message = str(raised.value)
    # A square board in `counts` does not determine which side of the visible board is meant as columns.
    visible_counts = ("8 x 7 inner corners (9 x 8 squares)", "7 x 8 inner corners (8 x 9 squares)")
    assert any(f"a checkerboard with {visible_count} is visible" in message for visible_count in visible_counts)
    assert f"({counts[0]} x {counts[1]} squares) were given" in message


def test_an_image_without_a_checkerboard_names_no_other_counts():
    image = np.random.default_rng(0).integers(0, 255, (400, 640), dtype=np.uint8)
    with pytest.raises(BoardNotSeenError, match="the board is not detected"):
        detect_board(image, Board(kind="checkerboard", columns=9, rows=8, pitch_m=0.02))
