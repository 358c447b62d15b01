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
from cell.simulation.devices.world import SimulatedWorld, simulated_world, world_truth
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.rendering.stereo_noise import MEDIAN_OF_FIVE

SMALL = (320, 200)


def small_world(**camera: object) -> SimulatedWorld:
    settings = CellSettings(camera=SimulatedCamera.model_validate(camera))
    world = simulated_world(settings)
    return replace(world, camera=camera_model(world.camera.name, SMALL))


def flange_looking_at(world: SimulatedWorld, azimuth_rad: float = 0.4) -> NDArray[np.float64]:
    return look_at(world.T_base_scene[:3, 3], azimuth_rad, 1.1, 0.5, 0.2) @ inverse(world.T_flange_camera)


def test_strings_are_seen_where_the_truth_says() -> None:
    world = small_world(model="ideal", errors=0.0)
    T_base_flange = flange_looking_at(world)
    z = FrameSource(world).expose(T_base_flange) * world.camera.depth_unit_m
    v, u = np.indices(z.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, (rays * z[..., None])[z > 0])
    table_z = world.T_base_scene[2, 3]
    # Half a depth count, 0.05 mm.
    assert points[:, 2].min() == pytest.approx(table_z, abs=1e-4)
    curve = np.array(world_truth(world)["curves"][0])
    string = points[points[:, 2] > table_z + 0.001]
    # Strings end square: the middle of an end is nearer to the line than the radius.
    string = string[np.linalg.norm(string[:, None] - curve[[0, -1]], axis=2).min(axis=1) > 2 * world.scene.radius_m]
    assert len(string) > 500
    distance = np.linalg.norm(string[:, None] - curve[None], axis=2).min(axis=1)
    # The written curve has a point every 2 mm: up to 0.12 mm more than the radius between two of them.
    assert distance.max() < world.scene.radius_m + 0.00025
    assert distance.min() > world.scene.radius_m - 0.0001


def test_exposures_from_one_pose_share_all_but_the_noise_of_each() -> None:
    world = small_world(model="oak-d-pro")
    source = FrameSource(world)
    T_base_flange = flange_looking_at(world)
    assert world.camera.noise is not None
    fb = world.camera.noise.focal_baseline_px_m
    stack = np.stack([source.expose(T_base_flange) for _ in range(40)]).astype(np.float64)
    # Whether a pixel can be measured does not change, nor where rims and holes are.
    assert np.array_equal((stack > 0).all(axis=0), (stack > 0).any(axis=0))
    disparity = fb / (stack[:, (stack > 0).all(axis=0)] * world.camera.depth_unit_m)
    frame_px = world.camera.noise.frame_px
    rounding_px = world.camera.noise.step_px / np.sqrt(12)
    # 40 exposures of some 60,000 pixels; rounding to 1/32 px and to 0.1 mm adds a little.
    assert np.sqrt(disparity.var(axis=0, ddof=1).mean()) == pytest.approx(np.hypot(frame_px, rounding_px), rel=0.02)


def test_the_median_of_five_exposures_is_as_steady_as_a_recording() -> None:
    world = small_world(model="oak-d-pro")
    source = FrameSource(world)
    T_base_flange = flange_looking_at(world)
    assert world.camera.noise is not None
    fb, frame_px = world.camera.noise.focal_baseline_px_m, world.camera.noise.frame_px
    first, second = (median([source.expose(T_base_flange) for _ in range(5)]).astype(np.float64) for _ in range(2))
    both = (first > 0) & (second > 0)
    difference = fb / (first[both] * world.camera.depth_unit_m) - fb / (second[both] * world.camera.depth_unit_m)
    # What the recordings of `pointchain simulate` have; rounding adds some 3 %.
    assert difference.std() / np.sqrt(2) == pytest.approx(frame_px * MEDIAN_OF_FIVE, rel=0.06)


def test_coming_back_to_a_pose_shows_the_same_fixed_errors() -> None:
    world = small_world(model="oak-d-pro")
    source = FrameSource(world)
    here, there = flange_looking_at(world, 0.4), flange_looking_at(world, 2.0)
    first, away, back = (source.expose(T) for T in (here, there, here))
    assert np.array_equal(first == 0, back == 0)
    assert not np.array_equal(first == 0, away == 0)
    assert not np.array_equal(first, back)  # another exposure
    # Another session with the same seed looks alike too, as after a camera was lost and connected again.
    assert np.array_equal(FrameSource(world).expose(here), first)


def test_the_told_pose_is_off_by_the_arm_s_error() -> None:
    exact, wrong = (small_world(model="ideal", errors=errors) for errors in (0.0, 20.0))
    T_base_flange = flange_looking_at(exact)
    a, b = (FrameSource(world).expose(T_base_flange).astype(np.int64) for world in (exact, wrong))
    shift_counts = np.median(np.abs(a - b)[(a > 0) & (b > 0)])
    # 10 mm and 2 degrees root mean square: some millimetres along the rays, of 0.1 mm each.
    assert 5 < shift_counts < 300


def test_a_picture_shows_what_the_depth_image_does() -> None:
    world = small_world(model="ideal", errors=0.0)
    T_base_flange = flange_looking_at(world)
    source = FrameSource(world)
    picture = source.picture(T_base_flange).astype(float)
    z = source.expose(T_base_flange) * world.camera.depth_unit_m
    v, u = np.indices(z.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, (rays * z[..., None]).reshape(-1, 3))
    high = points[:, 2].reshape(z.shape) - world.T_base_scene[2, 3]
    string, table = high > world.scene.radius_m, np.abs(high) < 1e-3
    assert string.sum() > 500
    # Strings throw back less than a third of the table's light; its spots vary by an eighth.
    assert np.median(picture[string]) < 0.6 * np.median(picture[table])
    assert np.quantile(picture[string], 0.9) < np.quantile(picture[table], 0.1)
    # Neither too dark nor too bright anywhere.
    assert (picture.min(), picture.max()) > (0, 60)
    assert picture.max() < 255


def test_pictures_from_one_pose_differ_by_the_sensor_s_noise_and_are_the_same_again() -> None:
    world = small_world(model="oak-d-pro")
    source = FrameSource(world)
    here, there = flange_looking_at(world, 0.4), flange_looking_at(world, 2.0)
    stack = np.stack([source.picture(here) for _ in range(40)])
    noise = np.sqrt(stack.astype(float).var(axis=0, ddof=1).mean())
    # Between no light and all the light that is counted; some 0.3 of it is the rounding.
    assert 1.5 < noise < 2.5
    assert not np.array_equal(source.picture(there), stack[0])
    assert np.array_equal([source.picture(here) for _ in range(3)], stack[:3])
    assert np.array_equal(FrameSource(world).picture(here), stack[0])
    other = replace(world, seed=world.seed + 1)
    assert not np.array_equal(FrameSource(other).picture(here), stack[0])


def test_depth_images_are_the_same_with_pictures_between_them() -> None:
    world = small_world(model="oak-d-pro")
    T_base_flange = flange_looking_at(world)
    alone, with_pictures = FrameSource(world), FrameSource(world)
    for _ in range(2):
        with_pictures.picture(T_base_flange)
        assert np.array_equal(alone.expose(T_base_flange), with_pictures.expose(T_base_flange))
