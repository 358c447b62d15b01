import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.camera.frame_averaging import median
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.planning.look_at import look_at
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.oak_pipeline import SimulatedImager
from cell.simulation.devices.world import SimulatedWorld, simulated_world, world_truth
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.rendering.stereo_camera import StereoCamera, StillPair
from cell.simulation.rendering.stereo_noise import MEDIAN_OF_FIVE

SMALL = (320, 200)


def small_world(**camera: object) -> SimulatedWorld:
    settings = CellSettings(camera=SimulatedCamera.model_validate(camera))
    world = simulated_world(settings)
    return replace(world, camera=camera_model(world.camera.name, SMALL))


def flange_looking_at(world: SimulatedWorld, azimuth_rad: float = 0.4) -> NDArray[np.float64]:
    return look_at(world.T_base_scene[:3, 3], azimuth_rad, 1.1, 0.5, 0.2) @ inverse(world.T_flange_camera)


def test_the_depth_image_shows_the_strings_at_their_true_positions() -> None:
    world = small_world(model="exact", errors=0.0)
    T_base_flange = flange_looking_at(world)
    z = FrameSource(world).render_depth(T_base_flange) * world.camera.depth_unit_m
    v, u = np.indices(z.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, (rays * z[..., None])[z > 0])
    table_z = world.T_base_scene[2, 3]
    # The depth is rounded to 0.1 mm.
    assert points[:, 2].min() == pytest.approx(table_z, abs=1e-4)
    curve = np.array(world_truth(world)["curves"][0])
    string = points[points[:, 2] > table_z + 0.001]
    # Strings have flat ends. A point on an end face is closer to the line than the radius.
    string = string[np.linalg.norm(string[:, None] - curve[[0, -1]], axis=2).min(axis=1) > 2 * world.scene.radius_m]
    assert len(string) > 500
    distance = np.linalg.norm(string[:, None] - curve[None], axis=2).min(axis=1)
    # The true curve has a point every 2 mm. Between two points, the distance exceeds the radius by up to 0.12 mm.
    assert distance.max() < world.scene.radius_m + 0.00025
    assert distance.min() > world.scene.radius_m - 0.0001


def test_exposures_from_one_pose_differ_only_by_their_noise() -> None:
    world = small_world(model="ideal")
    source = FrameSource(world)
    T_base_flange = flange_looking_at(world)
    assert world.camera.noise is not None
    fb = world.camera.noise.focal_baseline_px_m
    stack = np.stack([source.render_depth(T_base_flange) for _ in range(40)]).astype(np.float64)
    # The pixels without a measurement, such as rims and holes, do not change.
    assert np.array_equal((stack > 0).all(axis=0), (stack > 0).any(axis=0))
    disparity = fb / (stack[:, (stack > 0).all(axis=0)] * world.camera.depth_unit_m)
    frame_px = world.camera.noise.frame_px
    rounding_px = world.camera.noise.step_px / np.sqrt(12)
    # The rounding to 1/32 px and to 0.1 mm adds a little noise.
    assert np.sqrt(disparity.var(axis=0, ddof=1).mean()) == pytest.approx(np.hypot(frame_px, rounding_px), rel=0.02)


def test_the_median_of_five_exposures_has_the_noise_of_a_recording() -> None:
    world = small_world(model="ideal")
    source = FrameSource(world)
    T_base_flange = flange_looking_at(world)
    assert world.camera.noise is not None
    fb, frame_px = world.camera.noise.focal_baseline_px_m, world.camera.noise.frame_px
    first, second = (
        median([source.render_depth(T_base_flange) for _ in range(5)]).astype(np.float64) for _ in range(2)
    )
    both = (first > 0) & (second > 0)
    difference = fb / (first[both] * world.camera.depth_unit_m) - fb / (second[both] * world.camera.depth_unit_m)
    # This is the noise in recordings of `pointchain simulate`. Rounding adds about 3 %.
    assert difference.std() / np.sqrt(2) == pytest.approx(frame_px * MEDIAN_OF_FIVE, rel=0.06)


def test_a_repeated_pose_has_the_same_fixed_errors() -> None:
    world = small_world(model="ideal")
    source = FrameSource(world)
    here, there = flange_looking_at(world, 0.4), flange_looking_at(world, 2.0)
    first, away, back = (source.render_depth(T) for T in (here, there, here))
    assert np.array_equal(first == 0, back == 0)
    assert not np.array_equal(first == 0, away == 0)
    assert not np.array_equal(first, back)  # The noise of each exposure differs.
    # A new source with the same seed gives the same images, as after a camera was lost and connected again.
    assert np.array_equal(FrameSource(world).render_depth(here), first)


def test_the_reported_pose_has_the_error_of_the_arm() -> None:
    exact, wrong = (small_world(model="exact", errors=errors) for errors in (0.0, 20.0))
    T_base_flange = flange_looking_at(exact)
    a, b = (FrameSource(world).render_depth(T_base_flange).astype(np.int64) for world in (exact, wrong))
    shift_counts = np.median(np.abs(a - b)[(a > 0) & (b > 0)])
    # The errors are 10 mm and 2 degrees (rms). They shift the depth by some millimetres, in counts of 0.1 mm.
    assert 5 < shift_counts < 300


def test_the_intensity_image_shows_the_same_surfaces_as_the_depth_image() -> None:
    world = small_world(model="exact", errors=0.0)
    T_base_flange = flange_looking_at(world)
    source = FrameSource(world)
    picture = source.render_intensity(T_base_flange).astype(float)
    z = source.render_depth(T_base_flange) * world.camera.depth_unit_m
    v, u = np.indices(z.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, (rays * z[..., None]).reshape(-1, 3))
    high = points[:, 2].reshape(z.shape) - world.T_base_scene[2, 3]
    string, table = high > world.scene.radius_m, np.abs(high) < 1e-3
    assert string.sum() > 500
    # Strings reflect less than a third of the light that the table reflects. The table's texture varies by an eighth.
    assert np.median(picture[string]) < 0.6 * np.median(picture[table])
    assert np.quantile(picture[string], 0.9) < np.quantile(picture[table], 0.1)
    # No pixel is black or saturated.
    assert (picture.min(), picture.max()) > (0, 60)
    assert picture.max() < 255


def test_intensity_images_from_one_pose_differ_by_noise_that_is_repeatable() -> None:
    world = small_world(model="ideal")
    source = FrameSource(world)
    here, there = flange_looking_at(world, 0.4), flange_looking_at(world, 2.0)
    stack = np.stack([source.render_intensity(here) for _ in range(40)])
    noise = np.sqrt(stack.astype(float).var(axis=0, ddof=1).mean())
    # The noise is between that without light and that at full light. Rounding is about 0.3 of it.
    assert 1.5 < noise < 2.5
    assert not np.array_equal(source.render_intensity(there), stack[0])
    assert np.array_equal([source.render_intensity(here) for _ in range(3)], stack[:3])
    assert np.array_equal(FrameSource(world).render_intensity(here), stack[0])
    other = replace(world, seed=world.seed + 1)
    assert not np.array_equal(FrameSource(other).render_intensity(here), stack[0])


def test_intensity_images_do_not_change_the_depth_images() -> None:
    world = small_world(model="ideal")
    T_base_flange = flange_looking_at(world)
    alone, with_pictures = FrameSource(world), FrameSource(world)
    for _ in range(2):
        with_pictures.render_intensity(T_base_flange)
        assert np.array_equal(alone.render_depth(T_base_flange), with_pictures.render_depth(T_base_flange))


def stereo_world(**camera: object) -> SimulatedWorld:
    world = small_world(model="oak-d-pro", errors=0.0, **camera)
    return replace(world, camera=camera_model("oak-d-pro", (160, 100)))


def test_a_stereo_camera_shows_the_same_surfaces_in_depth_and_intensity() -> None:
    world = replace(stereo_world(sheath="smooth", table_top="printed"), camera=camera_model("oak-d-pro", SMALL))
    T_base_flange = flange_looking_at(world)
    source = FrameSource(world)
    picture = source.render_intensity(T_base_flange).astype(float)
    z = source.render_depth(T_base_flange) * world.camera.depth_unit_m
    _, string = DepthCamera(world.camera, world.scene).render(world.T_scene_camera(T_base_flange))
    on_string = string >= 0
    assert on_string.sum() > 500
    # The table's texture varies by 30 %, and the smooth sheath by 2 % and the shading around it.
    assert picture[on_string].std() < 0.6 * picture[~on_string].std()
    v, u = np.indices(z.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, (rays * z[..., None]).reshape(-1, 3))
    high = points[:, 2].reshape(z.shape) - world.T_base_scene[2, 3]
    # The matching window lowers the string. A pixel of disparity is 8 mm of depth at this distance and resolution.
    assert np.median(high[on_string & (z > 0)]) - np.median(high[~on_string & (z > 0)]) > 0.001


def test_exposures_of_a_stereo_camera_share_the_rendered_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    rendered = []
    render = StereoCamera.render

    def counted(self: StereoCamera, T: NDArray[np.float64], with_dots: bool) -> StillPair:
        rendered.append(T)
        return render(self, T, with_dots)

    monkeypatch.setattr(StereoCamera, "render", counted)
    world = stereo_world()
    source = FrameSource(world)
    here, there = flange_looking_at(world, 0.4), flange_looking_at(world, 2.0)
    first = source.render_depth(here)
    second = source.render_depth(here)
    pictures = [source.render_intensity(here) for _ in range(2)]
    assert len(rendered) == 1
    assert not np.array_equal(first, second)
    assert not np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(source.render_depth(there), first)
    assert len(rendered) == 2
    again = FrameSource(world)
    assert np.array_equal(again.render_intensity(here), pictures[0])
    assert np.array_equal(again.render_depth(here), first)


def test_both_images_of_a_stereo_camera_are_of_one_exposure() -> None:
    world = stereo_world()
    here = flange_looking_at(world, 0.4)
    source = FrameSource(world)
    both = source.render_both(here)
    assert both.intensity is not None
    # The depth is that of the same exposure without its intensity image.
    assert np.array_equal(FrameSource(world).render_depth(here), both.depth)
    # A second image differs by the noise of two exposures.
    off = source.render_intensity(here).astype(float) - both.intensity
    assert 1.5 < off.std() / np.sqrt(2) < 2.5
    assert abs(off.mean()) < 0.1


def test_the_other_cameras_render_both_images_apart() -> None:
    world = small_world(model="ideal")
    here = flange_looking_at(world, 0.4)
    both = FrameSource(world).render_both(here)
    assert np.array_equal(both.depth, FrameSource(world).render_depth(here))
    np.testing.assert_array_equal(both.intensity, FrameSource(world).render_intensity(here))


def test_dots_are_switched_for_new_images() -> None:
    world = stereo_world(table_top="bare", ir_dots=1.0)
    T_base_flange = flange_looking_at(world)
    source = FrameSource(world)
    bright = source.render_intensity(T_base_flange).astype(float)
    source.switch_dots(False)
    dark = source.render_intensity(T_base_flange).astype(float)
    without = FrameSource(replace(world, rendering=replace(world.rendering, ir_dots=0.0)))
    assert np.array_equal(dark, without.render_intensity(T_base_flange))
    source.switch_dots(True)
    assert np.array_equal(source.render_intensity(T_base_flange), bright)


def test_a_camera_with_rendered_images_renders_only_while_it_is_watched() -> None:
    for model, is_slow in (("oak-d-pro", True), ("ideal", False)):
        world = replace(small_world(model=model), camera=camera_model(model, (64, 40)))
        T_base_flange = flange_looking_at(world)
        imager = SimulatedImager(FrameSource(world), lambda pose=T_base_flange: pose, fps=30.0)
        assert (imager.take(time.monotonic(), pictured=False) is None) == is_slow
        imager.set_waiting(True)
        assert imager.take(time.monotonic(), pictured=False) is not None


def test_the_options_of_the_images_reach_the_camera() -> None:
    plain, bright = stereo_world(table_top="bare"), stereo_world(table_top="bare", ir_dots=1.0)
    assert plain.provenance | {"ir_dots": "1"} == bright.provenance
    assert plain.provenance["table_top"] == "bare"
    assert small_world(model="ideal").provenance == {}
    T_base_flange = flange_looking_at(plain)
    dark, lit = (FrameSource(world).render_intensity(T_base_flange).astype(float) for world in (plain, bright))
    # Dots of twice the lamp's light stand out of a table without texture.
    assert np.quantile(lit - dark, 0.99) > 20
