from typing import Any

import pytest
from pydantic import ValidationError

from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.camera_optics import DOT_PROJECTORS, STEREO_BASELINES_M
from cell.config.rendering_options import RenderingOptions, RenderingOptionsError


def test_options_are_configured_for_cameras_with_rendered_images() -> None:
    camera = SimulatedCamera.model_validate(
        {"model": "oak-d-pro", "sheath": "woven", "table_top": "bare", "ir_dots": 0.5}
    )
    assert camera.rendering == RenderingOptions("woven", "bare", 0.5)
    assert SimulatedCamera(model="d435").rendering == RenderingOptions()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"model": "ideal", "sheath": "woven"}, "sheath cannot be set for ideal, which renders no images"),
        ({"model": "ideal", "table_top": "bare", "ir_dots": 0.2}, "table_top and ir_dots cannot be set for ideal"),
        ({"model": "exact", "ir_dots": 0.2}, "ir_dots cannot be set for exact"),
        ({"model": "oak-d-sr", "ir_dots": 0.2}, "ir_dots is 0.2, but oak-d-sr has no dot projector"),
        ({"model": "oak-d-pro", "ir_dots": 1.1}, "less than or equal to 1"),
        ({"model": "oak-d-pro", "sheath": "hairy"}, "'speckled', 'painted', 'woven' or 'smooth'"),
    ],
)
def test_options_that_a_camera_does_not_have_are_rejected(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        SimulatedCamera.model_validate(settings)


def test_a_power_out_of_range_is_rejected() -> None:
    with pytest.raises(RenderingOptionsError, match="from 0 to 1"):
        RenderingOptions(ir_dots=-0.1).check("d435", has_images=True, has_dots=True)


def test_only_rendered_images_need_time() -> None:
    assert SimulatedCamera(model="oak-d-sr").rendering_s > 3
    assert SimulatedCamera(model="ideal").rendering_s == 0
    assert SimulatedCamera().rendering_s > 0, "the default renders"
    assert OakCamera(kind="oak").rendering_s == 0


def test_every_projector_belongs_to_a_stereo_camera() -> None:
    assert set(DOT_PROJECTORS) <= set(STEREO_BASELINES_M)
