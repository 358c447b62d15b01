from typing import Any, get_args

import numpy as np
import pytest
from pydantic import ValidationError

from cell.config.camera_config import CameraName, OakCamera, OakProduct, SimulatedCamera
from cell.config.camera_optics import baseline_m, oak_max_fps
from cell.simulation.rendering.depth_camera import CAMERAS


@pytest.mark.parametrize("name", get_args(CameraName))
def test_the_optics_of_a_simulated_camera_are_those_of_its_model(name: CameraName) -> None:
    model, optics = CAMERAS[name], SimulatedCamera(model=name).optics
    assert np.array_equal(optics.K, model.K)
    assert (optics.width, optics.height, optics.near_m) == (model.width, model.height, model.near_m)
    assert optics.working_m == model.working_m


# The minimum depths that Luxonis gives for its products, with its rounding.
@pytest.mark.parametrize(
    ("product", "size", "extended", "near_m", "tolerance_m"),
    [
        ("oak-d", (1280, 800), False, 0.70, 0.005),
        ("oak-d", (640, 400), False, 0.35, 0.005),
        ("oak-d", (640, 400), True, 0.20, 0.005),
        ("oak-d-pro", (1280, 800), True, 0.32, 0.005),
        ("oak-d-sr", (1280, 800), False, 0.20, 0.0),
    ],
)
def test_the_minimum_depth_of_an_oak_is_that_of_its_maker(
    product: OakProduct, size: tuple[int, int], extended: bool, near_m: float, tolerance_m: float
) -> None:
    camera = OakCamera(kind="oak", product=product, width=size[0], height=size[1], extended_disparity=extended)
    optics = camera.optics
    assert optics.near_m == pytest.approx(near_m, abs=tolerance_m)
    assert (optics.width, optics.height) == size
    near, far = optics.working_m
    assert optics.near_m < near < far < 1.0
    # A fifth of a pixel of disparity at the largest depth.
    assert 0.2 * far**2 / (optics.K[0, 0] * baseline_m(product)) < 0.0023


# The frame rates of Luxonis' table with subpixel and left-right check, and what follows for other sizes and modes.
@pytest.mark.parametrize(
    ("product", "size", "extended", "max_fps"),
    [
        ("oak-d-pro", (640, 400), False, 96.0),
        ("oak-d-pro", (1280, 720), False, 34.0),
        ("oak-d-pro", (1280, 800), False, 30.0),
        ("oak-d-pro", (640, 400), True, 58.0),  # 62 by the table, without subpixel
        ("oak-d-pro", (1280, 720), True, 20.0),  # 26 by the table, without subpixel
        ("oak-d-pro", (1280, 800), True, 18.0),
        ("oak4-d", (1280, 800), False, 42.0),
    ],
)
def test_the_frame_rate_is_limited_by_the_table_of_the_vendor(
    product: OakProduct, size: tuple[int, int], extended: bool, max_fps: float
) -> None:
    assert oak_max_fps(product, *size, extended) == max_fps
    camera = OakCamera(kind="oak", product=product, width=size[0], height=size[1], extended_disparity=extended)
    assert camera.max_fps == min(max_fps, 60.0)
    assert camera.frame_rate == min(max_fps, 30.0)
    assert camera.model_copy(update={"fps": 5.0}).frame_rate == 5.0


def test_a_frame_rate_beyond_the_limit_of_the_product_is_rejected() -> None:
    full: dict[str, Any] = {"kind": "oak", "width": 1280, "height": 800}
    assert OakCamera(**full, fps=30.0).frame_rate == 30.0
    with pytest.raises(ValidationError, match="fps is 31, but an oak-d-pro sends at most 30 depth images/s with 1280x"):
        OakCamera(**full, fps=31.0)
    with pytest.raises(ValidationError, match=r"at most 18 .* with 1280x800 and extended_disparity"):
        OakCamera(**full, fps=30.0, extended_disparity=True)


def test_an_exposure_longer_than_the_period_of_the_images_is_rejected() -> None:
    assert OakCamera(kind="oak", exposure_us=33_000).frame_rate == 30.0
    with pytest.raises(ValidationError, match="only 20000 microseconds from image to image with fps 50"):
        OakCamera(kind="oak", exposure_us=20_001, fps=50.0)


def test_the_field_of_view_does_not_depend_on_the_resolution() -> None:
    half, full = (
        OakCamera(kind="oak", width=width, height=height).optics for width, height in ((640, 400), (1280, 800))
    )
    assert half.width / half.K[0, 0] == full.width / full.K[0, 0]
    # The rectified images are 77 degrees wide.
    assert 2 * np.arctan(full.width / 2 / full.K[0, 0]) == pytest.approx(np.deg2rad(77), abs=0.01)


def test_a_configured_working_range_is_used() -> None:
    for camera in (SimulatedCamera(working_m=(0.3, 0.5)), OakCamera(kind="oak", working_m=(0.3, 0.5))):
        assert camera.optics.working_m == (0.3, 0.5)


def test_unknown_cameras_are_rejected() -> None:
    with pytest.raises(ValidationError, match="an oak-d-sr has none"):
        OakCamera(kind="oak", product="oak-d-sr", extended_disparity=True)
    with pytest.raises(ValidationError, match="no images of 640x480"):
        OakCamera(kind="oak", width=640, height=480)
