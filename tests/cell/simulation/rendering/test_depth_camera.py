from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import NotRigidError, transform_points
from cell.planning.look_at import look_at
from cell.simulation.rendering.depth_camera import CAMERAS, CameraModelError, DepthCamera, camera_model, draw_bias_px
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene, make_scene

SMALL = (320, 200)


def base_points(depth_m: NDArray[np.floating], K: NDArray, T_base_camera: NDArray) -> NDArray[np.float64]:
    """Return points (H, W, 3) by the pinhole model, independently of the code under test."""
    v, u = np.indices(depth_m.shape)
    camera = np.stack([(u - K[0, 2]) / K[0, 0] * depth_m, (v - K[1, 2]) / K[1, 1] * depth_m, depth_m], axis=-1)
    return transform_points(T_base_camera, camera.reshape(-1, 3)).reshape(camera.shape)


def line_distance(points: NDArray, curve: NDArray) -> NDArray[np.float64]:
    """Return the distances of points (N, 3) from the polyline `curve` (M, 3)."""
    a, ab = curve[:-1], np.diff(curve, axis=0)
    t = np.clip(((points[:, None] - a) * ab).sum(axis=2) / (ab**2).sum(axis=1), 0, 1)
    return np.linalg.norm(points[:, None] - (a + t[..., None] * ab), axis=2).min(axis=1)


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.3, np.deg2rad(50)), (2.5, np.deg2rad(70))])
def test_exact_depth_lies_on_string_and_table(azimuth: float, elevation: float) -> None:
    scene = make_scene("figure-eight", 3)
    model = camera_model("exact", SMALL)
    T = look_at(np.zeros(3), azimuth, elevation, 0.3, 0.2)
    camera = DepthCamera(model, scene)
    counts = camera.capture(T, np.random.default_rng(0))
    _, string = camera.render(T)
    points = base_points(counts * model.depth_unit_m, model.K, T)
    table = points[(string < 0) & (counts > 0)]
    # Half a depth unit, 0.05 mm.
    assert np.abs(table[:, 2]).max() < 6e-5
    on_string = points[string == 0][::5]
    assert len(on_string) > 200
    inside_ends = (
        np.linalg.norm(on_string[:, None] - scene.curves[0][[0, -1]], axis=2).min(axis=1) > scene.radius_m * 1.5
    )
    error = line_distance(on_string[inside_ends], scene.curves[0]) - scene.radius_m
    # Half a unit along the ray, and 0.15 % of the radius from the facets of the mesh.
    assert np.abs(error).max() < 6.5e-5


def test_strings_end_where_their_curves_end() -> None:
    scene = make_scene("straight", 0)
    model = camera_model("exact", SMALL)
    T = look_at(np.zeros(3), 0.0, np.deg2rad(70), 0.5, 0.0)
    depth, string = DepthCamera(model, scene).render(T)
    along = base_points(depth, model.K, T)[string == 0] @ (scene.curves[0][-1] - scene.curves[0][0]) / 0.4
    ends = np.sort(
        np.array([scene.curves[0][0], scene.curves[0][-1]]) @ (scene.curves[0][-1] - scene.curves[0][0]) / 0.4
    )
    # The last pixel is up to one pixel, here 2.3 mm, before the end. No pixel is beyond the end.
    assert [along.min(), along.max()] == pytest.approx(ends, abs=2.5e-3)
    assert ends[0] - 1e-6 <= along.min() <= along.max() <= ends[1] + 1e-6


def test_boxes_stand_on_the_table() -> None:
    box = Box((0.05, -0.02), (0.04, 0.03, 0.025), 0.4)
    scene = StringScene("box", 0.004, make_scene("straight", 0, radius_m=0.004, length_m=0.06).curves, (box,))
    model = camera_model("exact", SMALL)
    # Nearly from straight above, only the top of the box is visible.
    T = look_at(np.array([0.05, -0.02, 0.0]), 0.0, np.deg2rad(89.9), 0.4, 0.0)
    depth, string = DepthCamera(model, scene).render(T)
    points = base_points(depth, model.K, T)
    top = points[(points[..., 2] > 0.0249) & (string < 0)]
    assert top[:, 2] == pytest.approx(np.full(len(top), 0.025), abs=1e-5)
    assert top[:, :2].mean(axis=0) == pytest.approx(box.centre_m, abs=1e-3)
    pixel_m2 = (0.375 / model.focal_px) ** 2
    assert len(top) * pixel_m2 == pytest.approx(0.04 * 0.03, rel=0.05)


def test_the_same_generator_gives_the_same_image() -> None:
    camera = DepthCamera(camera_model("ideal", SMALL), make_scene("loop", 0), bias_px=0.1)
    T = look_at(np.zeros(3), 0.0, 1.0, 0.4, 0.0)
    first, again, other = (camera.capture(T, np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert first.dtype == np.uint16
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_points_below_the_minimum_distance_are_not_measured() -> None:
    model = camera_model("ideal", SMALL)
    camera = DepthCamera(model, make_scene("straight", 0))
    counts = camera.capture(look_at(np.zeros(3), 0.0, 1.0, 0.30, 0.0), np.random.default_rng(0))
    measured = counts[counts > 0] * model.depth_unit_m
    assert measured.min() >= model.near_m
    assert (counts == 0).mean() > 0.3


@pytest.mark.parametrize("name", CAMERAS)
def test_another_resolution_keeps_the_field_of_view(name: str) -> None:
    model, preset = camera_model(name, (800, 450)), CAMERAS[name]
    assert (model.width, model.height) == (800, 450)
    assert model.width / model.focal_px == pytest.approx(preset.width / preset.focal_px)
    assert model.noise == preset.noise


@pytest.mark.parametrize("resolution", [(640, 480), (1920, 1080), (16, 10), (0, 0)])
def test_impossible_resolutions_are_rejected(resolution: tuple[int, int]) -> None:
    with pytest.raises(CameraModelError, match="no depth image of"):
        camera_model("ideal-sr", resolution)


def test_each_sensor_has_its_own_largest_resolution() -> None:
    assert camera_model("oak-d-pro", (1280, 800)).focal_px == 805
    assert camera_model("d435", (1280, 720)).height == 720
    with pytest.raises(CameraModelError, match=r"from 32x20 to 1280x720, no higher than 0.566 of the width"):
        camera_model("d435", (1280, 800))
    with pytest.raises(CameraModelError, match="no depth image of 640x400"):
        camera_model("d435", (640, 400))


@pytest.mark.parametrize("name", ["oak-d-pro", "oak-d-sr", "d435"])
@pytest.mark.parametrize("width", [64, 424, 640, 848, 1280])
def test_the_search_reaches_the_smallest_distance_at_every_resolution(name: str, width: int) -> None:
    model = camera_model(name, (width, width // 2))
    assert model.stereo is not None
    assert model.stereo.disparities % 16 == 0
    assert model.stereo.disparities > model.focal_px * model.stereo.baseline_m / model.near_m
    assert model.noise is None


def test_stereo_cameras_have_the_figures_of_their_products() -> None:
    figures = {
        name: (model.stereo.baseline_m, model.stereo.disparities, model.stereo.has_dots, model.depth_unit_m)
        for name, model in CAMERAS.items()
        if model.stereo is not None
    }
    assert figures == {
        "oak-d-pro": (0.075, 96, True, 0.0001),
        "oak-d-sr": (0.020, 80, False, 0.0001),
        "d435": (0.050, 128, True, 0.001),
    }


def test_a_stereo_camera_renders_exact_depth_too() -> None:
    scene = make_scene("straight", 0)
    T = look_at(np.zeros(3), 0.3, 1.0, 0.4, 0.1)
    stereo = camera_model("oak-d-pro", (96, 60))
    depth, string = DepthCamera(stereo, scene).render(T)
    exact = replace(camera_model("ideal", (96, 60)), noise=None)
    depth_of_exact, string_of_exact = DepthCamera(exact, scene).render(T)
    assert np.array_equal(depth, depth_of_exact)
    assert np.array_equal(string, string_of_exact)


def test_the_depth_of_a_stereo_camera_is_zero_below_its_minimum_distance() -> None:
    model = camera_model("oak-d-pro", (160, 100))
    camera = DepthCamera(model, make_scene("straight", 0))
    counts = camera.capture(look_at(np.zeros(3), 0.0, 1.0, 0.34, 0.0), np.random.default_rng(0))
    measured = counts[counts > 0] * model.depth_unit_m
    assert measured.min() >= model.near_m
    assert len(measured) > 1000


def test_the_bias_of_a_session_has_the_spread_of_the_model() -> None:
    for name, spread_px in (("oak-d-pro", 0.1), ("ideal", 0.1), ("exact", 0.0)):
        drawn = [draw_bias_px(camera_model(name), np.random.default_rng(seed)) for seed in range(400)]
        # The standard deviation of 400 draws is off by 3.5 %.
        assert np.std(drawn) == pytest.approx(spread_px, rel=0.15)


def test_unknown_cameras_are_rejected() -> None:
    with pytest.raises(CameraModelError, match="known are oak-d-pro, oak-d-sr, d435, ideal-sr, ideal, ideal-measured"):
        camera_model("kinect")


def test_a_mirrored_pose_is_rejected() -> None:
    camera = DepthCamera(camera_model("exact", (32, 20)), make_scene("straight", 0))
    with pytest.raises(NotRigidError):
        camera.render(np.diag([1.0, 1.0, -1.0, 1.0]))
