import re
from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.assembly.table_frame import move_heights, move_model, move_registration
from recognition.messages import format_position
from recognition.model.findings import finding
from recognition.model.quality import Quality
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.measured_table import MeasuredTable
from recognition.registration.table_error import add_table_error, estimate_table_error
from recognition.request import RecognitionRequest
from recognition.result import Recognition

pytestmark = pytest.mark.slow

T_BASE_TABLE = from_rotation_vector((0, 0, -0.006), np.deg2rad((0.8, -0.6, 0.0)))
T = from_rotation_vector((0.001, -0.002, 0.005), (0.01, -0.02, 0.005))


def recognised(scan: SimulatedScan, radius_m: float | None = 0.0042) -> Recognition:
    return recognise(
        scan.views, RecognitionRequest(radius_m=radius_m, all_grasps=True), Scene(0.0, scan.header.workspace_m)
    )


def on_table(scene: StringScene, T_base_table: np.ndarray) -> SimulatedScan:
    return simulate(scene, camera_model("ideal"), 1, T_base_table=T_base_table)


@pytest.fixture(scope="module")
def lifted() -> Recognition:
    return recognised(on_table(make_scene("loop", seed=1), T_BASE_TABLE))


def test_positions_are_true_in_the_base_frame(lifted: Recognition) -> None:
    model, level = lifted.model, recognised(on_table(make_scene("loop", seed=1), np.eye(4))).model
    (found,) = [found for found in model.quality.findings if found.code == "table-elsewhere"]
    assert (found.severity, found.chains) == ("doubt", (0,))
    assert re.search(r"the table 6\.[0-9] mm lower than given and tilted by (0\.9|1\.0)", found.message)
    assert model.quality.verdict == "review"
    assert level.quality.verdict == "accept"
    assert model.gauss_code() == level.gauss_code()
    true = level.chains[0].points @ T_BASE_TABLE[:3, :3].T + T_BASE_TABLE[:3, 3]
    ends = [0, -1]
    np.testing.assert_allclose(model.chains[0].points[ends], true[ends], atol=0.003)
    # the positions also have the error of the measured table
    assert np.median(model.chains[0].sigma_m) > 1.5 * np.median(level.chains[0].sigma_m)


def test_all_results_are_in_the_base_frame(lifted: Recognition) -> None:
    assert lifted.registration is not None
    assert lifted.registration.hand_eye_error is None
    chain = lifted.model.chains[0]
    surface = lifted.registration.points
    distance = np.linalg.norm(surface[:, None] - chain.points[None], axis=2).min(axis=1)
    assert np.median(distance) == pytest.approx(chain.radius_m, abs=0.0005)
    assert lifted.height_map is not None
    centres, z = lifted.height_map.cell_centres(), lifted.height_map.z_m
    x, y = 0.15, -0.15
    near = np.linalg.norm(centres - (x, y), axis=2) < 0.03
    normal = T_BASE_TABLE[:3, 2]
    expected = T_BASE_TABLE[2, 3] - normal[:2] @ (x, y) / normal[2]
    assert np.nanmedian(z[near]) == pytest.approx(expected, abs=0.0015)
    assert lifted.model.grasps
    for grasp in lifted.model.grasps:
        assert not grasp.trusted
        assert np.linalg.norm(chain.points - grasp.T_base_grasp[:3, 3], axis=1).min() < 0.002
        # the approach is perpendicular to the table
        assert grasp.T_base_grasp[:3, 2] @ normal == pytest.approx(-1.0, abs=1e-4)
        assert grasp.T_base_flange.pregrasp[:3, 2] @ normal == pytest.approx(-1.0, abs=1e-4)


def test_the_radius_is_measured_above_the_measured_table() -> None:
    scan = on_table(make_scene("arc", seed=1), from_rotation_vector((0, 0, 0.006), (0, 0, 0)))
    model = recognised(scan, None).model
    assert model.parameters.r == pytest.approx(0.0042, rel=0.1)
    assert len(model.chains) == 1


def test_an_empty_lower_table_has_the_doubt() -> None:
    model = recognised(on_table(StringScene("empty", 0.0042, ()), T_BASE_TABLE)).model
    assert [found.code for found in model.quality.findings] == ["table-elsewhere", "no-string-in-view"]
    assert model.quality.verdict == "review"


def test_a_moved_model_has_moved_positions(lifted: Recognition) -> None:
    model = lifted.model
    point = model.chains[0].points[10]
    note = finding("piece-too-short", f"a piece at {format_position(point)} was excluded", point=point)
    model = replace(model, quality=Quality((), (*model.quality.findings, note)))
    moved = move_model(model, T)
    np.testing.assert_allclose(moved.chains[0].points, model.chains[0].points @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(moved.crossings[0].point, T[:3, :3] @ model.crossings[0].point + T[:3, 3])
    np.testing.assert_allclose(moved.grasps[0].T_base_grasp, T @ model.grasps[0].T_base_grasp)
    found = moved.quality.findings[-1]
    assert found.point_m == pytest.approx(moved.chains[0].points[10])
    assert format_position(moved.chains[0].points[10]) in found.message
    back = move_model(moved, inverse(T))
    np.testing.assert_allclose(back.chains[0].points, model.chains[0].points, atol=1e-12)


def test_a_moved_registration_and_its_covariance(lifted: Recognition) -> None:
    registration = lifted.registration
    assert registration is not None
    moved = move_registration(registration, T)
    np.testing.assert_allclose(moved.points, registration.points @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(moved.clouds[0].points, registration.clouds[0].points @ T[:3, :3].T + T[:3, 3])
    R = T[:3, :3]
    np.testing.assert_allclose(moved.covariance[3:6, 6:9], R @ registration.covariance[3:6, 6:9] @ R.T, atol=1e-15)


def test_the_error_of_the_table_is_common_to_all_views(lifted: Recognition) -> None:
    registration = lifted.registration
    assert registration is not None
    assert add_table_error(registration, None) is registration
    covariance = np.diag([1e-6, 4e-6, 9e-8])
    elsewhere, given = (
        MeasuredTable(registration.centre, np.array([0.0, 0.0, height_m]), covariance) for height_m in (-0.006, 0.0006)
    )
    for table, error in ((elsewhere, covariance), (given, estimate_table_error(given).covariance)):
        added = add_table_error(registration, table).covariance - registration.covariance
        for i, j in ((0, 0), (0, 1), (2, 5)):
            block = added[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
            np.testing.assert_allclose(block, np.diag([error[0, 0], error[1, 1], 0, 0, 0, error[2, 2]]), atol=1e-14)


@pytest.mark.parametrize("height_m", [-0.0018, 0.0018])
def test_a_table_that_is_hardly_elsewhere_is_in_sigma_and_in_a_note(height_m: float) -> None:
    """The poses are exact, so the model is off by as much as the given height. Errors of the poses might explain it."""
    scene, camera = make_scene("loop", seed=1), camera_model("ideal")
    scan = simulate(scene, camera, 1, errors=NO_ERRORS)
    level, off = (
        recognise(scan.views, RecognitionRequest(radius_m=0.0042), Scene(z, scan.header.workspace_m)).model
        for z in (0.0, -height_m)
    )
    (found,) = [found for found in off.quality.findings if found.code == "table-uncertain"]
    assert f"1.8 mm {'higher' if height_m > 0 else 'lower'} than given" in found.message
    assert (off.quality.verdict, level.quality.findings) == ("accept", ())
    error = off.chains[0].points[:, 2].mean() - level.chains[0].points[:, 2].mean()
    assert error == pytest.approx(-height_m, abs=0.0002)
    assert np.median(off.chains[0].sigma_m) > abs(height_m) / 2 > np.median(level.chains[0].sigma_m)


@pytest.mark.parametrize("height_m", [-0.006, 0.006])
def test_a_single_view_tells_a_table_that_is_elsewhere(height_m: float) -> None:
    scan = simulate(make_scene("loop", seed=1), camera_model("ideal"), 1, errors=NO_ERRORS, views=1)
    model, true = (
        recognise(scan.views, RecognitionRequest(radius_m=0.0042), Scene(z, scan.header.workspace_m)).model
        for z in (height_m, 0.0)
    )
    assert {"single-view", "table-elsewhere"} <= {found.code for found in model.quality.findings}
    assert model.quality.verdict == "review"
    distance = np.linalg.norm(model.chains[0].points[:, None] - true.chains[0].points[None], axis=2).min(axis=1)
    assert np.all(distance < 2 * model.chains[0].sigma_m)


def test_a_single_view_tells_a_camera_that_was_tilted() -> None:
    """The fixed camera was tilted by 1.72 degrees after its calibration."""
    scan = simulate(make_scene("loop", seed=1), camera_model("ideal"), 1, errors=NO_ERRORS, views=1)
    T_error = from_rotation_vector((0, 0, 0), (0.03, 0, 0))
    views = [replace(view, T_flange_camera=view.T_flange_camera @ T_error) for view in scan.views]
    model = recognise(views, RecognitionRequest(radius_m=0.0042), Scene(0.0, scan.header.workspace_m)).model
    (found,) = [found for found in model.quality.findings if found.code == "table-elsewhere"]
    # the alignment of the view to the table plane has a tilt error of 0.09 degrees (`PoseSigmas.table_rad`)
    assert float(found.message.split("tilted by ")[1].split()[0]) == pytest.approx(1.72, abs=0.1)


def test_heights_are_moved_with_the_plane(lifted: Recognition) -> None:
    heights = lifted.height_map
    assert heights is not None
    moved = move_heights(replace(heights, z_m=np.zeros_like(heights.z_m)), T)
    centres = heights.cell_centres()
    plane = T[2, 0] * centres[..., 0] + T[2, 1] * centres[..., 1] + T[2, 3]
    np.testing.assert_allclose(moved.z_m, plane, atol=1e-6)
