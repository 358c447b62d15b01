from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.devices import View
from cell.simulation.cases import Case, make_case, simulate
from cell.simulation.offline_scan import SimulatedScan
from cell.simulation.offline_scan import simulate as simulate_scene
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.rendering.stereo_noise import StereoNoise
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.depth_correction.depth_warp import (
    MIN_VIEWS,
    TERMS,
    DepthWarp,
    TableSample,
    correct,
    is_similar,
    measure_warp,
    sample_table,
)
from recognition.preprocessing.table_measurement import measure_table
from recognition.preprocessing.target_cloud import Scene

Error = NDArray[np.float64]


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    """A string on a table, seen by a camera without a warp."""
    return simulate(make_case("paper", 4, "ideal"))


def with_error(view: View, inverse_depth: Error) -> View:
    """Return the view with an error (H, W) of its inverse depth, 1/m."""
    depth_m = view.depth * view.depth_unit_m
    counts = np.rint(depth_m / (1 + depth_m * inverse_depth) / view.depth_unit_m)
    return replace(view, depth=counts.astype(np.uint16))


def bowl(view: View, amplitude: float = 0.01) -> Error:
    """Return a slow error of the camera without a constant and a linear part: 0.01 / m is 1.6 mm at 0.4 m."""
    height, width = view.depth.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return amplitude * (x**2 - 1 / 3 + x * y * y)


def shown(views: list[View], scan: SimulatedScan) -> list[TableSample]:
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    samples = []
    for view in views:
        plane = measure_table(view, scene)
        assert plane is not None
        found = sample_table(view, plane, scene)
        assert found is not None
        samples.append(found)
    return samples


def table_area(view: View, scan: SimulatedScan) -> NDArray[np.bool_]:
    """Return the pixels (H, W) whose ray meets the table in the workspace."""
    rows, columns = np.indices(view.depth.shape)
    rays = (
        np.stack([columns, rows, np.ones_like(rows)], axis=2) @ np.linalg.inv(view.K).T @ view.T_base_camera[:3, :3].T
    )
    points = view.T_base_camera[:3, 3] - rays * (view.T_base_camera[2, 3] / rays[..., 2:])
    assert scan.header.workspace_m is not None
    sides = np.array(scan.header.workspace_m[:2])
    return np.all((points[..., :2] > sides[:, 0]) & (points[..., :2] < sides[:, 1]), axis=2)


def test_a_camera_without_a_warp_is_not_corrected(scan: SimulatedScan) -> None:
    assert measure_warp(shown(list(scan.views), scan)) is None


def test_the_warp_that_all_views_show_is_measured_where_the_table_is(scan: SimulatedScan) -> None:
    true = bowl(scan.views[0])
    warp = measure_warp(shown([with_error(view, true) for view in scan.views], scan))
    assert warp is not None
    measured = warp.inverse_depth_error(scan.views[0].depth.shape)
    for view in scan.views[:3]:
        area = table_area(view, scan)
        y, x = np.nonzero(area)
        linear = np.column_stack([np.ones(len(x)), x, y])
        rest = (measured - true)[area]
        rest -= linear @ np.linalg.lstsq(linear, rest, rcond=None)[0]
        # The linear part cannot be measured. Pixel locking leaves waves of some hundredths of a pixel (0.0006 / m).
        assert np.sqrt(np.mean(rest**2)) < 0.001
    depth_m = np.concatenate([(view.depth * view.depth_unit_m)[table_area(view, scan)] for view in scan.views])
    assert warp.rms_m == pytest.approx(0.004 * np.mean(depth_m**2), rel=0.5)


def test_a_corrected_image_has_the_depth_without_the_error(scan: SimulatedScan) -> None:
    view = scan.views[0]
    coefficients = np.random.default_rng(1).normal(0, 0.003, shown([view], scan)[0].terms.shape[1])
    warp = DepthWarp(coefficients, 0.001)
    corrected = correct(with_error(view, warp.inverse_depth_error(view.depth.shape)), warp)
    assert (corrected.index, corrected.depth_unit_m <= view.depth_unit_m) == (view.index, True)
    np.testing.assert_array_equal(corrected.depth > 0, view.depth > 0)
    # Both images are rounded to the unit of the captured one, half of which is the largest error of each.
    error_m = corrected.depth * corrected.depth_unit_m - view.depth * view.depth_unit_m
    assert np.abs(error_m[view.depth > 0]).max() < 1.1 * view.depth_unit_m
    empty = correct(replace(view, depth=np.zeros_like(view.depth)), warp)
    assert not empty.depth.any()


def test_a_corrected_image_keeps_its_intensity_image(scan: SimulatedScan) -> None:
    warp = DepthWarp(np.zeros(len(TERMS)), 0.0)
    for intensity in (None, np.ones(scan.views[0].depth.shape, dtype=np.uint8)):
        assert correct(replace(scan.views[0], intensity=intensity), warp).intensity is intensity


def test_patterns_that_differ_from_view_to_view_are_not_a_warp(scan: SimulatedScan) -> None:
    signs = (1, -1, -1, 1, 1, -1, 1, -1)
    views = [with_error(view, sign * bowl(view)) for view, sign in zip(scan.views, signs, strict=True)]
    assert measure_warp(shown(views, scan)) is None


@pytest.mark.parametrize("height_m", [0.001, 0.003, 0.005])
@pytest.mark.parametrize("side_m", [0.1, 0.2, 0.3])
def test_a_plate_in_the_middle_of_all_images_is_not_a_warp(height_m: float, side_m: float) -> None:
    scene = StringScene("plate", 0.0042, (), (Box((0.0, 0.0), (side_m, side_m, height_m), 0.0),))
    scan = simulate_scene(scene, camera_model("ideal"), 1)
    assert measure_warp(shown(list(scan.views), scan)) is None


def test_a_warp_is_measured_beside_a_plate() -> None:
    scene = StringScene("plate", 0.0042, (), (Box((0.0, 0.0), (0.2, 0.2, 0.003), 0.0),))
    scan = simulate_scene(scene, camera_model("ideal"), 1)
    true = bowl(scan.views[0])
    warp = measure_warp(shown([with_error(view, true) for view in scan.views], scan))
    assert warp is not None
    view = scan.views[1]
    area = table_area(view, scan)
    y, x = np.nonzero(area)
    linear = np.column_stack([np.ones(len(x)), x, y])
    rest = (warp.inverse_depth_error(view.depth.shape) - true)[area]
    rest -= linear @ np.linalg.lstsq(linear, rest, rcond=None)[0]
    # Twice the tolerance without a plate: its edges take pixels away.
    assert np.sqrt(np.mean(rest**2)) < 0.002


def test_too_few_views_or_pixels_show_no_warp(scan: SimulatedScan) -> None:
    samples = shown([with_error(view, bowl(view)) for view in scan.views], scan)
    assert measure_warp(samples[: MIN_VIEWS - 1]) is None
    assert measure_warp(samples[:MIN_VIEWS]) is not None
    view = scan.views[0]
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    plane = measure_table(view, scene)
    assert plane is not None
    strip = view.depth.copy()
    strip[40:] = 0
    assert sample_table(replace(view, depth=strip), plane, scene) is None


def test_warps_are_similar_if_they_hardly_differ_on_the_table(scan: SimulatedScan) -> None:
    samples = shown(list(scan.views), scan)
    warp = measure_warp(shown([with_error(view, bowl(view)) for view in scan.views], scan))
    assert warp is not None
    assert is_similar(None, None, samples)
    assert not is_similar(warp, None, samples)
    assert is_similar(warp, replace(warp, coefficients=1.02 * warp.coefficients), samples)
    assert not is_similar(warp, replace(warp, coefficients=1.5 * warp.coefficients), samples)


def test_the_warp_of_a_measured_camera_is_found_and_that_of_a_good_one_is_not() -> None:
    case = make_case("measured", 40)
    noise = case.camera.noise
    assert isinstance(noise, StereoNoise)
    assert noise.warp_px > 0
    good: Case = replace(case, camera=replace(case.camera, noise=replace(noise, warp_px=0.0)))
    warped, straight = simulate(case), simulate(good)
    assert measure_warp(shown(list(warped.views), warped)) is not None
    assert measure_warp(shown(list(straight.views), straight)) is None
