from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.preprocessing.table_measurement import measure_table
from recognition.preprocessing.target_cloud import Scene

HALF_M = 0.2
SCENE = Scene(0.0, ((-HALF_M, HALF_M), (-HALF_M, HALF_M), (0.0, 0.12)))


def first_view(*boxes: Box, height_m: float = 0.0, tilt_deg: float = 0.0) -> View:
    """Return a view of boxes on a table at a height, tilted about x."""
    T_base_table = from_rotation_vector((0, 0, height_m), (np.deg2rad(tilt_deg), 0, 0))
    scene = StringScene("table", 0.0042, (), boxes)
    camera = camera_model("ideal", (320, 200))
    # the first of two views; a scan of one view would show its workspace from farther away
    return simulate(scene, camera, 1, errors=NO_ERRORS, views=2, T_base_table=T_base_table).views[0]


def plate(height_m: float, side_m: float) -> Box:
    return Box((0.0, 0.0), (side_m, side_m, height_m), 0.0)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(0.0, 0.0), (-0.01, 0.0), (0.01, 2.0), (-0.03, 0.0), (0.0, 5.0)])
def test_the_table_is_measured_wherever_it_is(height_m: float, tilt_deg: float) -> None:
    plane = measure_table(first_view(height_m=height_m, tilt_deg=tilt_deg), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(height_m, abs=5e-4)
    np.testing.assert_allclose(plane.slope, (0.0, np.tan(np.deg2rad(tilt_deg))), atol=3e-3)
    assert not plane.has_rival


@pytest.mark.parametrize("plate_height_m", [0.004, 0.01])
def test_the_table_under_a_large_plate_is_measured(plate_height_m: float) -> None:
    plane = measure_table(first_view(plate(plate_height_m, 0.24)), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(0.0, abs=5e-4)
    assert not plane.has_rival


def test_the_given_table_is_kept_where_a_lower_surface_lies_around_it() -> None:
    plane = measure_table(first_view(plate(0.015, 0.24), height_m=-0.015), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(0.0, abs=5e-4)
    assert not plane.has_rival


def test_two_planes_of_which_neither_is_the_given_table_are_rivals() -> None:
    plane = measure_table(first_view(plate(0.01, 0.3), height_m=0.006), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(0.006, abs=5e-4)
    assert plane.has_rival


def test_no_table_is_measured_beyond_the_search_range_or_in_a_strip() -> None:
    assert measure_table(first_view(height_m=-0.06), SCENE) is None
    strip = Scene(0.0, ((-HALF_M, HALF_M), (-0.005, 0.005), (0.0, 0.12)))
    assert measure_table(first_view(), strip) is None


def test_a_box_is_no_table() -> None:
    plane = measure_table(first_view(plate(0.04, 0.1)), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(0.0, abs=5e-4)


def test_noise_is_no_second_plane() -> None:
    view = first_view()
    noise = np.random.default_rng(1).normal(0, 0.0025 / view.depth_unit_m, view.depth.shape)
    plane = measure_table(replace(view, depth=np.round(view.depth + noise).astype(np.uint16)), SCENE)
    assert plane is not None
    assert plane.height_at(np.zeros(2)) == pytest.approx(0.0, abs=7e-4)
    assert not plane.has_rival
