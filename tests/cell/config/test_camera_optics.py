import numpy as np
import pytest
from pydantic import ValidationError

from cell.config.camera_config import CameraName, OakCamera, OakProduct, SimulatedCamera
from cell.config.camera_optics import baseline_m
from cell.simulation.rendering.depth_camera import CAMERAS


@pytest.mark.parametrize("name", ["oak-d-sr", "oak-d-pro", "ideal"])
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
