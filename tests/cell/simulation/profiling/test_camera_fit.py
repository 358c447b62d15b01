"""Round trip: a simulated camera, its profile, and the camera that reproduces it."""

from dataclasses import replace

import numpy as np
import pytest

from cell.camera_profile.depth_profile import ProfileError, from_document
from cell.camera_profile.measure import PoseImages, TablePose, measure_profile
from cell.config.rendering_options import RenderingOptions
from cell.simulation.profiling.camera_fit import FitOptions, fit_camera, nearest_base, visible_warp_share
from cell.simulation.profiling.table_view import TableViewing, camera_above, view_table
from cell.simulation.rendering.depth_camera import CameraModel, camera_model, camera_of_preset
from tests.cell.camera_profile.test_depth_profile import PROFILE

pytestmark = pytest.mark.slow


def table(distance_m: float, tilt: float) -> TablePose:
    return TablePose(np.array([np.sin(tilt), 0.0, np.cos(tilt)]) / distance_m)


TABLES = [table(0.42, 0.3), table(0.46, -0.25)]


def seen(model: CameraModel, images: int = 4, seed: int = 7) -> list[PoseImages]:
    return view_table(model, TABLES, TableViewing(RenderingOptions(), seed, images))


def changed(block_px: int, warp_px: float, baseline_m: float) -> CameraModel:
    """Return a camera with other parameters."""
    model = camera_model("oak-d-pro")
    assert model.stereo is not None
    matching = replace(model.stereo.matching, block_px=block_px)
    pair = replace(model.stereo, matching=matching, warp_px=warp_px, baseline_m=baseline_m)
    return replace(model, stereo=pair, table_top="printed")


def test_the_parameters_of_a_changed_camera_are_found() -> None:
    model = changed(block_px=7, warp_px=0.3, baseline_m=0.06)
    preset = fit_camera(seen(model), FitOptions(base="oak-d-pro", is_median=False))
    assert preset.focal_px == pytest.approx(model.focal_px)
    assert preset.baseline_m == pytest.approx(0.06, rel=0.01)
    assert abs(preset.block_px - 7) <= 2
    assert preset.warp_px == pytest.approx(0.3, rel=0.35)
    assert preset.table_top == "printed"
    assert preset.noise_factor == pytest.approx(1.0, rel=0.5)
    assert preset.sources["baseline_m"] == "measured"
    assert preset.sources["row_error_px"] == "default"
    assert any(note.startswith("bias_px is that of oak-d-pro") for note in preset.notes)
    # the same character again, with another seed
    measured = from_document(preset.measured)
    again = measure_profile(seen(camera_of_preset(preset), seed=8)).profile
    assert again.ripple_m == pytest.approx(measured.ripple_m, rel=0.3)
    assert again.locking_m == pytest.approx(measured.locking_m, rel=0.3)
    assert again.rest_m == pytest.approx(measured.rest_m, rel=0.35)
    assert again.temporal_m == pytest.approx(measured.temporal_m, rel=0.35)
    assert again.correlation_px == pytest.approx(measured.correlation_px, rel=0.35)


def test_depth_without_windows_is_refused_unless_a_camera_is_named() -> None:
    model = camera_model("ideal", (320, 200))
    images = view_table(model, TABLES, TableViewing())
    with pytest.raises(ProfileError, match=r"no pixel locking.*--like"):
        fit_camera(images, FitOptions())
    preset = fit_camera(images, FitOptions(base="oak-d-pro"))
    assert preset.sources["baseline_m"] == "default"
    assert preset.block_px == 5
    assert any("pixel locking is not reproduced" in note for note in preset.notes)


@pytest.mark.parametrize(
    ("focal_px", "width", "focal_baseline_px_m", "base"),
    [
        (402.5, 640, 30.2, "oak-d-pro"),
        (402.5, 640, None, "oak-d-pro"),
        (763.0, 1280, 15.3, "oak-d-sr"),
        (915.0, 1280, 45.7, "d435"),
        (430.0, 848, None, "d435"),
    ],
)
def test_the_most_similar_camera_is_the_base(
    focal_px: float, width: int, focal_baseline_px_m: float | None, base: str
) -> None:
    profile = replace(PROFILE, focal_px=focal_px, width=width, focal_baseline_px_m=focal_baseline_px_m)
    assert nearest_base(profile) == base


def test_a_warp_is_seen_without_its_linear_part() -> None:
    assert 0.6 < visible_warp_share((200, 320)) < 1.0


def test_a_camera_above_a_table_sees_it_as_given() -> None:
    T = camera_above(TABLES[0])
    height_m = T[2, 3]
    assert height_m == pytest.approx(0.42)
    # z of the scene in the camera frame is the normal towards the camera
    np.testing.assert_allclose(T[2, :3], -TABLES[0].n * 0.42, atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
