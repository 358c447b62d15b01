"""Depth images are coloured by height above the table and cropped to the workspace."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording.header import RecordingHeader
from service.api.images.depth_image import MAX_SIZE_PX, draw_depth
from service.api.images.height_colours import MAX_HEIGHT_M, MIN_HEIGHT_M

TABLE_Z_M = 0.1
HEADER = RecordingHeader(1e-4, None, np.eye(4), table_z_m=TABLE_Z_M)
CAMERA_HEIGHT_M = 0.5
"""Height of the camera above the table."""


def view_of(heights_m: NDArray[np.float64], K: NDArray[np.float64] | None = None) -> View:
    """Return a view straight down on a surface with these heights above the table. NaN is unmeasured."""
    height, width = heights_m.shape
    depth = np.where(np.isnan(heights_m), 0, np.rint((CAMERA_HEIGHT_M - heights_m) / 1e-4)).astype(np.uint16)
    if K is None:
        K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]])
    down = from_rotation_vector((0.0, 0.0, TABLE_Z_M + CAMERA_HEIGHT_M), (np.pi, 0.0, 0.0))
    return View(0, depth, 1e-4, K, down, np.eye(4), 1.79e9)


def draw_pixels(view: View, header: RecordingHeader = HEADER) -> NDArray[np.uint8]:
    """Return the pixels of the image, BGR."""
    picture = cv2.imdecode(np.frombuffer(draw_depth(view, header), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, dtype=np.uint8)


def test_low_is_blue_high_is_yellow_and_unmeasured_is_black() -> None:
    heights = np.zeros((60, 80))
    heights[:20], heights[20:40], heights[40:] = MIN_HEIGHT_M - 0.01, MAX_HEIGHT_M + 0.01, np.nan
    picture = draw_pixels(view_of(heights)).astype(int)
    blue, yellow = picture[5, 5], picture[30, 30]
    assert blue[0] > blue[2]
    assert yellow[2] > yellow[0]
    assert (picture[50:] == 0).all()
    assert blue.sum() > 0


def heights_from_colours(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the heights above the table in metres, from the colours alone."""
    scale = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_CIVIDIS).reshape(256, 3).astype(int)
    steps = np.abs(picture[..., None, :].astype(int) - scale).sum(axis=-1).argmin(axis=-1)
    return MIN_HEIGHT_M + steps / 255 * (MAX_HEIGHT_M - MIN_HEIGHT_M)


def test_the_colour_of_a_string_is_its_height() -> None:
    radius_m, pixel_m = 0.0042, 0.0005
    across_m = np.arange(-30, 30) * pixel_m
    profile = np.where(np.abs(across_m) < radius_m, radius_m + np.sqrt((radius_m**2 - across_m**2).clip(0)), 0.0)
    picture = draw_pixels(view_of(np.tile(profile[:, None], (1, 80))))
    # one colour step is 0.12 mm, a few steps look the same, and one count of depth is 0.1 mm
    np.testing.assert_allclose(heights_from_colours(picture), np.tile(profile[:, None], (1, 80)), rtol=0, atol=4e-4)


def test_a_slanted_view_is_coloured_by_height_and_not_by_distance() -> None:
    """A flat table has one colour, whatever the distance of its points."""
    width, height = 80, 60
    T = from_rotation_vector((0.0, -0.4, TABLE_Z_M + CAMERA_HEIGHT_M), (-np.pi + 0.6, 0.3, 0.1))
    v, u = np.mgrid[:height, :width]
    rays = np.stack([(u - 40) / 80, (v - 28) / 90, np.ones_like(u)], axis=-1) @ T[:3, :3].T
    depth = np.rint(-CAMERA_HEIGHT_M / rays[..., 2] / 1e-4).astype(np.uint16)
    K = np.array([[80.0, 0, 40], [0, 90, 28], [0, 0, 1]])
    T_flange_camera = from_rotation_vector((0.03, -0.06, 0.05), (0.05, 0.02, -1.55))
    picture = draw_pixels(View(0, depth, 1e-4, K, T @ np.linalg.inv(T_flange_camera), T_flange_camera, 1.79e9))
    assert np.ptp(depth) * 1e-4 > 0.2
    # one count of depth is 0.1 mm; the colours have 256 steps for 30 mm
    assert np.ptp(picture.reshape(-1, 3).astype(int), axis=0).max() <= 4
    np.testing.assert_allclose(heights_from_colours(picture), 0.0, rtol=0, atol=4e-4)


def test_the_image_is_cropped_to_the_visible_workspace() -> None:
    view = view_of(np.zeros((60, 80)))
    # One metre above would be 80 pixels wide; on the table, 0.5 m away, a metre is 160 pixels.
    box = ((-0.1, 0.1), (-0.05, 0.05), (TABLE_Z_M, TABLE_Z_M + 0.001))
    height, width = draw_pixels(view, replace(HEADER, workspace_m=box)).shape[:2]
    assert (width, height) == (34, 18)  # 32 x 16 at the table, and the upper side is nearer
    for elsewhere in (
        ((2.0, 2.1), (0.0, 0.1), (0.0, 0.1)),  # outside the image
        ((-0.1, 0.1), (-0.1, 0.1), (0.0, TABLE_Z_M + CAMERA_HEIGHT_M)),  # up to the camera
        ((-1e-3, 1e-3), (-1e-3, 1e-3), (TABLE_Z_M, TABLE_Z_M + 1e-3)),  # a few pixels
    ):
        assert draw_pixels(view, replace(HEADER, workspace_m=elsewhere)).shape[:2] == (60, 80)


def test_a_large_image_is_scaled_down() -> None:
    for shape in ((2048, 2048), (800, 1280), (3, 1400), (1400, 3)):
        picture = draw_pixels(view_of(np.zeros(shape)))
        assert max(picture.shape[:2]) <= MAX_SIZE_PX
        assert max(picture.shape[:2]) > MAX_SIZE_PX / 2
    for focal in (1e6, 1.0):
        strange = np.array([[focal, 0, 1], [0, focal, 1], [0, 0, 1]])
        box = ((-100.0, 100.0), (-100.0, 100.0), (-100.0, TABLE_Z_M + CAMERA_HEIGHT_M - 2e-3))
        assert draw_pixels(view_of(np.zeros((40, 40)), strange), replace(HEADER, workspace_m=box)).size > 0
