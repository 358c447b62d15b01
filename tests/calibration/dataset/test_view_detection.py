"""Detection of the board in the images of a folder: real files, rendered images with known corners."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.dataset.folder import read_folder
from calibration.dataset.view_detection import detect_views, read_image
from calibration.errors import BoardMirroredError, BoardNotSeenError, CalibrationFolderError
from calibration.target.board import Board
from calibration.target.detection import DetectedBoard
from tests.calibration.rendered_board import K_640, true_pixels
from tests.calibration.rendered_folder import X, Y, rendered_folder

pytestmark = pytest.mark.slow

SIZE = (640, 400)


def test_the_corners_of_all_images_are_detected_at_their_true_pixels(tmp_path: Path) -> None:
    reported: list[tuple[str, int]] = []

    def report(name: str, sighting: DetectedBoard | str) -> None:
        assert not isinstance(sighting, str), sighting
        reported.append((name, len(sighting.ids)))

    seen = detect_views(read_folder(rendered_folder(tmp_path, views=3, held_out=1)), report)
    assert [view.name for view in seen.observations.views] == ["01", "02", "03"]
    assert [view.name for view in seen.held_out.views] == ["04"]
    assert (seen.observations.camera_id, seen.observations.board, seen.excluded) == ("19443010", Board(), ())
    for view in seen.observations.views:
        expected = true_pixels(Board(), np.linalg.inv(X) @ np.linalg.inv(view.T_base_flange) @ Y, K_640)
        # The error of the robot, 0.1 mm and 0.02 degrees, is about 0.2 px here. A wrong numbering would give 20 px.
        assert np.abs(view.pixels - expected[view.ids]).max() < 1.0
        assert len(view.ids) > 0.9 * len(expected)
    assert reported == [(view.name, len(view.ids)) for view in (*seen.observations.views, *seen.held_out.views)]


@pytest.mark.parametrize("suffix", [".jpg", ".bmp", ".tif", ".TIFF"])
def test_images_may_have_several_formats_and_be_grey_or_colour(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    # The image is smooth, so JPEG changes it by a few grey levels only.
    colour = cv2.resize(rng.integers(0, 255, (5, 8, 3), dtype=np.uint8), SIZE, interpolation=cv2.INTER_LINEAR)
    for image in (colour, colour[:, :, 0]):
        coded = cv2.imencode(suffix.lower(), image)[1]
        (tmp_path / f"a{suffix}").write_bytes(coded.tobytes())
        got = read_image(tmp_path / f"a{suffix}", SIZE)
        assert (got.shape, got.dtype) == (image.shape, np.uint8)
        assert np.abs(got.astype(int) - image).mean() < (3 if suffix == ".jpg" else 1e-9)


def exif(orientation: int) -> bytes:
    """Return the segment of a JPEG file with the orientation of the camera."""
    tiff = b"II*\0" + struct.pack("<IHHHIIi", 8, 1, 0x112, 3, 1, orientation, 0)
    return b"\xff\xe1" + struct.pack(">H", 8 + len(tiff)) + b"Exif\0\0" + tiff


def test_the_orientation_tag_does_not_rotate_the_pixels(tmp_path: Path) -> None:
    image = np.zeros((400, 640), dtype=np.uint8)
    image[:100, :100] = 255
    coded = cv2.imencode(".jpg", image)[1].tobytes()
    path = tmp_path / "a.jpg"
    path.write_bytes(coded[:2] + exif(3) + coded[2:])
    turned = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert turned is not None
    assert turned[50, 50] == 0, "OpenCV rotates the image by default"
    assert read_image(path, SIZE)[50, 50] == 255


def huge_png() -> bytes:
    """Return a small PNG file that announces 100 000 pixels in width and height."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 9)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is not an image or is damaged: use PNG, JPEG, BMP or TIFF"),
        (b"not an image at all", "is not an image"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 50, "is not an image"),
        (huge_png(), "is not an image"),
        (
            cv2.imencode(".png", np.zeros((400, 600), np.uint8))[1].tobytes(),
            "has 600 x 400 pixels, and setup.json says",
        ),
    ],
)
def test_files_that_are_not_images_of_this_camera_are_rejected(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(CalibrationFolderError) as refused:
        read_image(path, SIZE)
    assert expected in str(refused.value)
    assert str(path) in str(refused.value)


def spoilt(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


@pytest.mark.parametrize(
    "spoil",
    [
        spoilt(b"no image"),
        spoilt(cv2.imencode(".png", np.full((400, 640), 127, np.uint8))[1].tobytes()),
        spoilt(cv2.imencode(".png", np.full((300, 400), 127, np.uint8))[1].tobytes()),
    ],
    ids=["no image", "nothing to see", "another size"],
)
def test_one_bad_image_is_named_and_excluded(tmp_path: Path, spoil: Callable[[Path], object]) -> None:
    folder = rendered_folder(tmp_path, views=3, held_out=0)
    spoil(folder / "02.png")
    seen = detect_views(read_folder(folder))
    assert [view.name for view in seen.observations.views] == ["01", "03"]
    ((name, reason),) = seen.excluded
    assert name == "02"
    assert reason


def test_the_reason_is_reported_if_no_image_shows_the_board(tmp_path: Path) -> None:
    with pytest.raises(BoardMirroredError, match="no image shows the board; 01: "):
        detect_views(read_folder(rendered_folder(tmp_path / "mirrored", views=2, held_out=0, mirrored=True)))
    other = rendered_folder(tmp_path / "other", views=2, held_out=0)
    setup = (other / "setup.json").read_text()
    (other / "setup.json").write_text(setup.replace("DICT_4X4_50", "DICT_5X5_50"))
    with pytest.raises(BoardNotSeenError, match="no image shows the board; 01: "):
        detect_views(read_folder(other))


def test_dots_without_a_marked_first_are_numbered_consistently(tmp_path: Path) -> None:
    board = Board(kind="circles", columns=7, rows=7, pitch_m=0.02)
    seen = detect_views(read_folder(rendered_folder(tmp_path, board, views=5, held_out=1)))
    views = (*seen.observations.views, *seen.held_out.views)
    assert len(views) == 6
    # The first corner is any of the four, but the same in all views.
    firsts = []
    for view in views:
        corners = true_pixels(board, np.linalg.inv(X) @ np.linalg.inv(view.T_base_flange) @ Y, K_640)
        first = view.pixels[list(view.ids).index(0)]
        firsts.append(int(np.linalg.norm(corners - first, axis=1).argmin()))
    assert len(set(firsts)) == 1
    assert firsts[0] in (0, 6, 42, 48)
