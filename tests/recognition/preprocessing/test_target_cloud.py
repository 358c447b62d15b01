"""Target point clouds of depth images."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
from cell.devices import View
from recognition.depth_correction.depth_warp import CorrectedView
from recognition.errors import InvalidSceneError
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene, deproject, intensity_of, preprocess

EXACT = {"rtol": 0, "atol": 1e-14}
"""A few roundings of doubles below a metre."""

# Upside down, half a metre above the table: base x = 0.1 + x, y = 0.2 - y, z = 0.5 - z.
T_BASE_CAMERA = from_rotation_vector((0.1, 0.2, 0.5), (np.pi, 0, 0))
K = np.array([[100.0, 0.0, 50.0], [0.0, 200.0, 40.0], [0.0, 0.0, 1.0]])


def view_of(depth: np.ndarray, T_base_camera: np.ndarray = T_BASE_CAMERA, unit_m: float = 1e-4) -> View:
    T_flange_camera = from_rotation_vector((0.01, 0.02, 0.03), (0.1, 0.2, 0.3))
    return View(7, depth.astype(np.uint16), unit_m, K, T_base_camera @ inverse(T_flange_camera), T_flange_camera)


def pixels(counts: dict[tuple[int, int], int]) -> np.ndarray:
    """Return an 80 x 100 depth image with the given counts at (v, u), else 0."""
    depth = np.zeros((80, 100))
    for (v, u), count in counts.items():
        depth[v, u] = count
    return depth


def at_heights(*heights_mm: float) -> np.ndarray:
    """Return a depth image with 2 x 2 separate pixels at each height above the table z = 0."""
    counts = [round((0.5 - h / 1000) / 1e-4) for h in heights_mm]
    return pixels({(40 + v, 3 * k + u): count for k, count in enumerate(counts) for v in (0, 1) for u in (0, 1)})


def four(v: int, u: int) -> list[tuple[int, int]]:
    """Return a pixel and three neighbours: together they pass the filter of flying pixels."""
    return [(v, u), (v, u + 1), (v + 1, u), (v + 1, u + 1)]


def test_deprojection_agrees_with_a_calculation_by_hand() -> None:
    # (80 - 50) / 100 * 0.5 = 0.15 right, (20 - 40) / 200 * 0.5 = -0.05 down, 0.5 m ahead.
    points = deproject(view_of(pixels({(20, 80): 5000})), np.array([20, 0]), np.array([80, 0]))
    # The other pixel is not measured and gives the position of the camera.
    np.testing.assert_allclose(points, [(0.25, 0.25, 0.0), (0.1, 0.2, 0.5)], **EXACT)


def test_every_pixel_of_an_oblique_view_is_on_its_ray() -> None:
    rng = np.random.default_rng(0)
    T = from_rotation_vector((0.3, -0.2, 0.6), (2.0, 1.0, -0.5))
    depth = rng.integers(1, 8000, (80, 100))
    v, u = np.array([0, 0, 79, 79, 33]), np.array([0, 99, 0, 99, 61])
    z = depth[v, u] * 5e-5
    camera_points = np.column_stack([(u - 50) / 100 * z, (v - 40) / 200 * z, z])
    np.testing.assert_allclose(deproject(view_of(depth, T, 5e-5), v, u), transform_points(T, camera_points), **EXACT)


def test_points_up_to_the_threshold_are_removed(table_1: ChainParameters) -> None:
    target = preprocess(view_of(at_heights(0.0, 4.9, 5.1, 9.0)), table_1, Scene())
    np.testing.assert_allclose(np.sort(target.points[:, 2]), [0.0051] * 4 + [0.009] * 4, rtol=0, atol=1e-9)
    assert (target.view, target.n_measured, target.n_in_workspace) == (7, 16, 16)
    # Too few points for a table plane: no alignment.
    np.testing.assert_array_equal(target.T_table_alignment, np.eye(4))
    np.testing.assert_allclose(target.T_base_camera, T_BASE_CAMERA, **EXACT)


def test_the_threshold_is_measured_from_the_table(table_1: ChainParameters) -> None:
    target = preprocess(view_of(at_heights(104.9, 105.1)), table_1, Scene(table_z_m=0.1))
    np.testing.assert_allclose(target.points[:, 2], [0.1051] * 4, rtol=0, atol=1e-9)


def test_points_outside_the_workspace_are_removed(table_1: ChainParameters) -> None:
    # All at z = 0.01, 0.49 m ahead: x = 0.1 + (u - 50) / 100 * 0.49, y = 0.2 - (v - 40) / 200 * 0.49.
    inside, left, behind = four(40, 50), four(40, 20), four(10, 50)
    depth = pixels(dict.fromkeys((*inside, *left, *behind), 4900))
    box = ((0.0, 0.2), (0.15, 0.25), (0.0, 0.1))
    target = preprocess(view_of(depth), table_1, Scene(workspace_m=box))
    np.testing.assert_allclose(target.points[0], (0.1, 0.2, 0.01), **EXACT)
    assert (len(target.points), target.n_measured, target.n_in_workspace) == (4, 12, 4)
    too_low = Scene(workspace_m=((0.0, 0.2), (0.15, 0.25), (-0.1, 0.009)))
    assert preprocess(view_of(depth), table_1, too_low).n_in_workspace == 0


@pytest.mark.parametrize("box", [((-1.0, 1.0), (-1.0, 1.0), (0.0, 0.1)), ((-1, 1), (-1, 1), (0, 1))])
def test_table_points_just_below_the_floor_are_in_the_workspace(
    table_1: ChainParameters, box: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
) -> None:
    target = preprocess(view_of(at_heights(-2.0, 1.0, -50.0)), table_1, Scene(workspace_m=box))
    assert target.n_in_workspace == 8


def test_a_view_with_a_pose_error_is_aligned_first(table_1: ChainParameters) -> None:
    depth = np.full((80, 100), 5000)
    depth[40:42, 30:70] = 4920
    # The arm reports the camera 2 mm too high.
    T_error = from_rotation_vector((0.0, 0.0, 0.002), (0, 0, 0))
    target = preprocess(view_of(depth, T_error @ T_BASE_CAMERA), table_1, Scene())
    # The reported heights are 2 and 10 mm; the ridge of 8 mm is found at 8 mm, except for rounding in the fit.
    assert len(target.points) == 80
    np.testing.assert_allclose(target.points[:, 2], 0.008, rtol=0, atol=1e-12)
    np.testing.assert_allclose(target.T_table_alignment, inverse(T_error), rtol=0, atol=1e-12)
    np.testing.assert_allclose(target.T_base_camera, T_BASE_CAMERA, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("depth", "measured", "constant"),
    [
        (pixels({}), 0, False),
        (pixels({(3, 4): 4900}), 1, False),
        (pixels({(3, 4): 4900, (3, 5): 4900}), 2, True),
        (pixels({(3, 4): 4900, (3, 5): 4901}), 2, False),
        (np.full((80, 100), 65535), 8000, True),
    ],
    ids=["empty", "one pixel", "two alike", "two", "saturated"],
)
def test_empty_and_constant_depth_are_recognised(
    table_1: ChainParameters, depth: np.ndarray, measured: int, constant: bool
) -> None:
    target = preprocess(view_of(depth), table_1, Scene())
    assert (target.n_measured, target.constant_depth) == (measured, constant)
    assert target.points.shape == (len(target.points), 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"table_z_m": float("nan")}, "table_z_m is nan"),
        ({"table_z_m": float("inf")}, "table_z_m is inf"),
        ({"workspace_m": ((0, 1), (0, 1))}, "x0 < x1 and so on is needed"),
        ({"workspace_m": ((0, 1), (1, 0), (0, 1))}, "x0 < x1 and so on is needed"),
        ({"workspace_m": ((0, 1), (0, 1), (0, 0))}, "x0 < x1 and so on is needed"),
        ({"workspace_m": ((0, 1), (0, 1), (0, float("inf")))}, "x0 < x1 and so on is needed"),
    ],
)
def test_an_invalid_scene_is_an_error(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        Scene(**arguments)


def test_the_points_of_a_large_image_are_counted_by_a_sample(table_1: ChainParameters) -> None:
    depth = np.full((500, 700), 5000)
    depth[200:300, 100:200] = 4900
    K_large = np.array([[700.0, 0.0, 350.0], [0.0, 700.0, 250.0], [0.0, 0.0, 1.0]])
    view = View(0, depth.astype(np.uint16), 1e-4, K_large, T_BASE_CAMERA, np.eye(4))
    half = Scene(workspace_m=((0.1, 1.0), (-1.0, 1.0), (0.0, 0.1)))
    for scene, share in ((Scene(), 1.0), (half, 0.5)):
        target = preprocess(view, table_1, scene)
        assert target.n_measured == 350_000
        # The sample may have a column more or fewer.
        assert target.n_in_workspace == pytest.approx(350_000 * share, rel=0.02)
    # The plate is kept except for its four corners, which have three neighbours.
    assert len(preprocess(view, table_1, Scene()).points) == 9996


@pytest.mark.parametrize("far_m", [1e3, 1e20, 1e200])
def test_a_pose_beyond_the_reach_shows_nothing(table_1: ChainParameters, far_m: float) -> None:
    T = T_BASE_CAMERA.copy()
    T[0, 3] = far_m
    view = View(0, np.full((80, 100), 4900, dtype=np.uint16), 1e-4, K, T, np.eye(4))
    target = preprocess(view, table_1, Scene())
    assert (len(target.points), target.n_in_workspace) == (0, 0)
    T[0, 3], T[2, 3] = 0.1, far_m
    assert preprocess(View(0, view.depth, 1e-4, K, T, np.eye(4)), table_1, Scene()).n_in_workspace == 0


@pytest.mark.parametrize(
    ("point", "is_near"),
    [
        ((0.0, 0.0, 0.05), False),
        ((0.095, 0.0, 0.05), True),
        ((0.0, -0.195, 0.05), True),
        ((0.0, 0.0, 0.095), True),
        ((0.0, 0.0, 0.001), False),
        ((0.3, 0.0, 0.05), True),
    ],
    ids=["inside", "right side", "front side", "top", "floor", "outside"],
)
def test_the_border_of_the_workspace_is_its_sides_and_its_top(point: tuple[float, float, float], is_near: bool) -> None:
    scene = Scene(workspace_m=((-0.1, 0.1), (-0.2, 0.2), (0.0, 0.1)))
    assert scene.is_near_border(np.array(point), 0.01) == is_near
    assert not Scene().is_near_border(np.array(point), 0.01)


def noisy_table(noise_m: float) -> View:
    """Return a view of a bare table with noise that blocks of 4 x 4 pixels share."""
    noise = np.random.default_rng(1).normal(0, noise_m, (60, 80)).repeat(4, axis=0).repeat(4, axis=1)
    K_fine = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]])
    return View(7, np.round((0.5 + noise) / 1e-4).astype(np.uint16), 1e-4, K_fine, T_BASE_CAMERA, np.eye(4))


@pytest.mark.parametrize("radius_m", [0.001, 0.0042])
def test_errors_that_neighbouring_pixels_share_are_measured_for_any_radius(radius_m: float) -> None:
    # A pixel has an edge of 1.25 mm on the table, and a block one of 5 mm. The even sample has every third pixel.
    view = noisy_table(0.0005)
    heights = (view.depth * view.depth_unit_m)[: 240 // 4 * 4]
    edge = round(2 * radius_m / 0.00125)
    means = np.lib.stride_tricks.sliding_window_view(heights, (edge, edge)).mean(axis=(2, 3))
    scatter = preprocess(view, ChainParameters.for_radius(radius_m), Scene(0.0)).scatter
    assert scatter.patch_m == pytest.approx(means.std(), rel=0.2)


def test_errors_that_each_pixel_has_alone_are_not_in_patches(table_1: ChainParameters) -> None:
    noise = np.random.default_rng(1).normal(0, 0.0005, (240, 320))
    depth = np.round((0.5 + noise) / 1e-4).astype(np.uint16)
    scatter = preprocess(replace(noisy_table(0.0), depth=depth), table_1, Scene(0.0)).scatter
    assert scatter.patch_m is not None
    assert scatter.patch_m < 0.0001


def test_noise_gives_as_many_points_below_the_table_as_above(table_1: ChainParameters) -> None:
    workspace = ((-0.2, 0.4), (-0.1, 0.5), (-0.001, 0.3))
    target = preprocess(noisy_table(0.0025), table_1, Scene(0.0, workspace))
    assert target.scatter.pixel_m == pytest.approx(0.0025, rel=0.15)
    assert len(target.points) > 500
    assert target.n_below == pytest.approx(len(target.points), rel=0.3)
    # A string radius of 4.2 mm allows a scatter of 1 mm.
    assert preprocess(noisy_table(0.0005), table_1, Scene(0.0, workspace)).n_below == 0


def test_a_view_needs_no_intensity_image() -> None:
    depth = pixels({(20, 80): 5000})
    intensity = np.ones(depth.shape, dtype=np.uint8)
    assert intensity_of(view_of(depth)) is None
    assert intensity_of(replace(view_of(depth), intensity=intensity)) is intensity
    # Any object with the attributes of the protocol is a view.
    assert intensity_of(CorrectedView(7, depth.astype(np.uint16), 1e-4, K, T_BASE_CAMERA)) is None
