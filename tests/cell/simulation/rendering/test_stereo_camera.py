from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from cell.config.rendering_options import RenderingOptions, RenderingOptionsError, Sheath, TableTop
from cell.planning.look_at import look_at
from cell.simulation.rendering.depth_camera import CameraModel, DepthCamera, ImageContent, camera_model
from cell.simulation.rendering.stereo_camera import StillPair, slow_field
from cell.simulation.scenes.scenes import make_scene

SCENE = make_scene("straight", 0)
POSE = look_at(np.zeros(3), 0.4, np.deg2rad(75), 0.4, 0.1)
SMALL = camera_model("oak-d-pro", (320, 200))


def rectified(model: CameraModel) -> CameraModel:
    """Return the camera without the errors of its rectification."""
    assert model.stereo is not None
    return replace(model, stereo=replace(model.stereo, warp_px=0.0, row_error_px=0.0))


def camera(
    sheath: Sheath, table_top: TableTop, ir_dots: float = 0.0, model: CameraModel = SMALL, bias_px: float = 0.0
) -> DepthCamera:
    return DepthCamera(model, SCENE, bias_px, 3, ImageContent(RenderingOptions(sheath, table_top, ir_dots)))


def pair(cam: DepthCamera) -> StillPair:
    still = cam.still_view(POSE, np.random.default_rng(0))
    assert isinstance(still, StillPair)
    return still


def table_error_px(cam: DepthCamera) -> NDArray[np.float64]:
    """Return the disparity error of the table, NaN where it is not measured, without its edges in the image."""
    model = cam.model
    assert model.stereo is not None
    depth_m = cam.capture(POSE, np.random.default_rng(0)) * model.depth_unit_m
    exact_m, string = cam.render(POSE)
    # Near a string the matching window mixes string and table.
    near_string = np.zeros(string.shape, dtype=np.bool_)
    for rows in range(-6, 7):
        for columns in range(-6, 7):
            near_string |= np.roll(string >= 0, (rows, columns), axis=(0, 1))
    focal_baseline = model.focal_px * model.stereo.baseline_m
    measured_px = focal_baseline / np.where(depth_m > 0, depth_m, np.nan)
    error = measured_px - focal_baseline / exact_m
    # The left edge of the left image is not in the right image.
    left = int(focal_baseline / exact_m.min()) + 8
    inside = ~near_string
    inside[:, :left] = False
    return error[inside]


def ridge_m(cam: DepthCamera) -> tuple[float, float]:
    """Return the median height of the measured ridge, and of the exact one."""
    counts = cam.capture(POSE, np.random.default_rng(0))
    exact_m, _ = cam.render(POSE)
    K = cam.model.K
    v, u = np.indices(counts.shape)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    measured = transform_points(POSE, (rays * (counts * cam.model.depth_unit_m)[..., None]).reshape(-1, 3))[:, 2]
    exact = transform_points(POSE, (rays * exact_m[..., None]).reshape(-1, 3))[:, 2]
    top = (exact > 1.9 * SCENE.radius_m) & (counts.ravel() > 0)
    assert top.sum() > 50
    return float(np.median(measured[top])), float(np.median(exact[top]))


def test_a_textured_table_is_measured_to_a_fraction_of_a_pixel() -> None:
    error = table_error_px(camera("speckled", "printed", model=rectified(SMALL)))
    assert np.isnan(error).mean() < 0.01
    # The cost of OpenCV's matching pulls disparities towards whole ones by up to 0.3 pixel.
    assert np.nanquantile(np.abs(error), 0.95) < 0.35
    assert abs(np.nanmedian(error)) < 0.05
    assert np.mean(np.abs(error) > 1) < 0.002


def test_a_bare_table_is_measured_badly_and_dots_give_it_texture() -> None:
    bare, dotted = (table_error_px(camera("smooth", "bare", dots)) for dots in (0.0, 0.6))
    # Without texture, the matching finds some disparity or none: more than half of the pixels are wrong or missing.
    assert np.mean(~(np.abs(bare) < 1)) > 0.3
    assert np.mean(~(np.abs(dotted) < 1)) < 0.02


def test_the_matching_window_lowers_a_string() -> None:
    model = camera_model("oak-d-pro", (480, 300))
    measured, exact = ridge_m(camera("speckled", "printed", model=model))
    # The ridge is a few pixels wide, and the window mixes it with the table. Exact depth gives the highest pixels of
    # the string, which lie within 5 % of 2 r.
    assert exact == pytest.approx(2 * SCENE.radius_m, rel=0.05)
    assert 0.5 * SCENE.radius_m < measured < exact - 0.2 * SCENE.radius_m


def test_the_bias_shifts_all_disparities() -> None:
    model = rectified(SMALL)
    without, biased = (
        np.nanmean(table_error_px(camera("speckled", "printed", model=model, bias_px=bias_px)))
        for bias_px in (0.0, 0.3)
    )
    # The pull towards whole disparities takes or adds up to a tenth of a pixel.
    assert biased - without == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize("shape", [(200, 320), (61, 97)])
def test_the_rectification_error_is_slow_and_has_the_stated_size(shape: tuple[int, int]) -> None:
    field = slow_field(shape, 0.15, np.random.default_rng(2))
    assert np.sqrt(np.mean(field**2)) == pytest.approx(0.15, rel=1e-5)
    # Sums of cosines over whole half periods have no mean.
    assert abs(field.mean()) < 1e-6
    # Three half periods, each of amplitude below 1 px, change by at most 3 pi / width per pixel.
    assert np.abs(np.diff(field, axis=1)).max() < 3 * np.pi / shape[1]


def test_the_same_seed_gives_the_same_images() -> None:
    tiny = camera_model("oak-d-pro", (96, 60))
    first, again, other = (DepthCamera(tiny, SCENE, 0.0, seed) for seed in (3, 3, 4))
    still, still_again, still_other = (
        each.still_view(POSE, np.random.default_rng(0)) for each in (first, again, other)
    )
    assert isinstance(still, StillPair)
    assert isinstance(still_again, StillPair)
    assert isinstance(still_other, StillPair)
    assert np.array_equal(still.left, still_again.left)
    assert np.array_equal(still.right, still_again.right)
    assert not np.array_equal(still.left, still_other.left)
    captures = [each.capture(POSE, np.random.default_rng(1)) for each in (first, again)]
    assert np.array_equal(captures[0], captures[1])


def test_exposures_share_the_pair_and_differ_by_their_noise() -> None:
    cam = camera("speckled", "printed")
    still = pair(cam)
    before = (still.left.copy(), still.right.copy())
    rng = np.random.default_rng(1)
    depths = np.stack([cam.expose(still, rng) for _ in range(5)]) * cam.model.depth_unit_m
    assert np.array_equal(before[0], still.left)
    assert np.array_equal(before[1], still.right)
    assert not np.array_equal(depths[0], depths[1])
    measured = (depths > 0).all(axis=0)
    disparities = cam.model.focal_px * 0.075 / depths[:, measured]
    # On good texture, the noise of the sensor moves a disparity by less than a tenth of a pixel.
    assert 0.005 < np.median(disparities.std(axis=0)) < 0.1


def test_the_intensity_image_is_the_mean_of_the_left_images() -> None:
    cam = camera("speckled", "printed")
    still = pair(cam)
    images = cam.capture_images(POSE, np.random.default_rng(1))
    assert images.intensity is not None
    # The noise of five images is at most 1.1 grey levels, and rounding 0.3.
    off = images.intensity - still.left.clip(0, 255)
    assert 0.5 < off.std() < 1.2
    assert abs(off.mean()) < 0.05
    assert np.array_equal(images.depth, cam.capture(POSE, np.random.default_rng(1)))


def test_a_noise_model_has_no_left_image() -> None:
    cam = DepthCamera(camera_model("ideal", (160, 100)), SCENE)
    assert cam.capture_images(POSE, np.random.default_rng(1)).intensity is None


def test_options_of_images_are_rejected_for_other_cameras() -> None:
    content = ImageContent(RenderingOptions(sheath="woven"))
    with pytest.raises(RenderingOptionsError, match="sheath cannot be set for ideal"):
        DepthCamera(camera_model("ideal", (64, 40)), SCENE, content=content)
