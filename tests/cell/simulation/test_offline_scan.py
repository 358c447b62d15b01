import json
from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, transform_points
from cell.config.rendering_options import RenderingOptions, RenderingOptionsError
from cell.recording import RecordingExistsError, read_recording
from cell.simulation.offline_scan import SimulatedScan, ViewCountError, simulate, truth_path, write_simulation
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.ground_truth import scene_truth, true_crossings
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

CAMERA = camera_model("ideal", (160, 100))


@pytest.fixture(scope="module")
def scene() -> StringScene:
    return make_scene("overhand-knot", 1)


@pytest.fixture(scope="module")
def scan(scene: StringScene) -> SimulatedScan:
    return simulate(scene, CAMERA, seed=5, views=3)


def test_the_same_seed_gives_the_same_scan(scene: StringScene, scan: SimulatedScan) -> None:
    again = simulate(scene, CAMERA, seed=5, views=3)
    other = simulate(scene, CAMERA, seed=6, views=3)
    for a, b, c in zip(scan.views, again.views, other.views, strict=True):
        assert np.array_equal(a.depth, b.depth)
        assert np.array_equal(a.T_base_flange, b.T_base_flange)
        assert not np.array_equal(a.depth, c.depth)
        assert a.intensity is None
        assert not np.array_equal(a.T_base_flange, c.T_base_flange)
    assert again.truth == scan.truth


def test_reported_poses_have_the_configured_errors(scan: SimulatedScan) -> None:
    for view, T in zip(scan.views, scan.truth["T_base_camera"], strict=True):
        apart = np.linalg.norm(view.T_base_camera[:3, 3] - np.array(T)[:3, 3])
        # Robot 0.5 mm, 0.1 degrees at 8 cm from the flange, hand-eye 0.7 mm: 0.9 mm root mean square.
        assert 1e-5 < apart < 4e-3


def test_without_errors_the_reported_poses_are_true(scene: StringScene) -> None:
    exact = simulate(scene, CAMERA, seed=5, errors=NO_ERRORS, views=2)
    for view, T in zip(exact.views, exact.truth["T_base_camera"], strict=True):
        assert view.T_base_camera == pytest.approx(np.array(T), abs=1e-12)
    assert np.array_equal(exact.header.T_flange_camera, exact.truth["T_flange_camera"])


def test_a_stereo_scan_is_repeatable_and_says_what_its_images_show(scene: StringScene) -> None:
    camera = camera_model("oak-d-pro", (96, 60))
    drawn, again = (simulate(scene, camera, seed=5, views=1) for _ in range(2))
    assert np.array_equal(drawn.views[0].depth, again.views[0].depth)
    assert drawn.views[0].intensity is not None
    np.testing.assert_array_equal(again.views[0].intensity, drawn.views[0].intensity)
    given = simulate(scene, camera, seed=5, views=1, rendering=RenderingOptions("smooth", "bare", 0.5))
    shown = {key: given.header.provenance[key] for key in ("sheath", "table_top", "ir_dots")}
    assert shown == {"sheath": "smooth", "table_top": "bare", "ir_dots": "0.5"}
    assert drawn.header.provenance["sheath"] in {"speckled", "painted", "woven"}
    assert drawn.header.provenance["ir_dots"] == "0"
    assert "sheath" not in simulate(scene, CAMERA, seed=5, views=1).header.provenance
    with pytest.raises(RenderingOptionsError, match="ir_dots cannot be set for ideal"):
        simulate(scene, CAMERA, seed=5, views=1, rendering=RenderingOptions(ir_dots=0.5))


@pytest.mark.parametrize("views", [0, -1, 65])
def test_impossible_numbers_of_views_are_rejected(scene: StringScene, views: int) -> None:
    with pytest.raises(ViewCountError, match="from 1 to 64"):
        simulate(scene, CAMERA, seed=0, views=views)


def test_the_workspace_contains_the_strings() -> None:
    wide = make_scene("straight", 0, length_m=0.7)
    header = simulate(wide, camera_model("exact", (32, 20)), seed=0, views=1).header
    assert header.workspace_m is not None
    box = np.array(header.workspace_m)
    assert (wide.curves[0] > box[:, 0]).all()
    assert (wide.curves[0] < box[:, 1]).all()


def test_a_single_view_shows_its_workspace() -> None:
    scan = simulate(make_scene("loop", 1), camera_model("ideal", (320, 200)), seed=1, views=1)
    model = recognise(scan.views, RecognitionRequest(radius_m=0.0042), Scene(0.0, scan.header.workspace_m)).model
    assert "table-not-covered" not in {found.code for found in model.quality.findings}


def test_the_written_scan_is_read_back(scene: StringScene, tmp_path: Path) -> None:
    scan = simulate(scene, camera_model("oak-d-pro", (96, 60)), seed=5, views=2)
    path = tmp_path / "scan.mcap"
    assert write_simulation(scan, path) == tmp_path / "scan.truth.json"
    recording = read_recording(path)
    assert recording.missing == ()
    assert recording.header.string_radius_m == 0.0042
    assert recording.header.provenance["scene"] == "overhand-knot-1"
    for read, view in zip(recording.views, scan.views, strict=True):
        assert np.array_equal(read.depth, view.depth)
        assert view.intensity is not None
        np.testing.assert_array_equal(read.intensity, view.intensity)
        assert read.T_base_camera == pytest.approx(view.T_base_camera, abs=1e-9)
    assert json.loads(truth_path(path).read_text()) == json.loads(json.dumps(scan.truth))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["scan.mcap", "scan.truth.json"]


def test_the_same_scan_gives_the_same_bytes(scene: StringScene, scan: SimulatedScan, tmp_path: Path) -> None:
    write_simulation(scan, tmp_path / "a.mcap")
    write_simulation(simulate(scene, CAMERA, seed=5, views=3), tmp_path / "b.mcap")
    for end in (".mcap", ".truth.json"):
        assert (tmp_path / f"a{end}").read_bytes() == (tmp_path / f"b{end}").read_bytes()


@pytest.mark.parametrize("there", ["scan.mcap", "scan.truth.json"])
def test_nothing_is_overwritten(scan: SimulatedScan, tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("precious")
    with pytest.raises(RecordingExistsError, match="nothing is overwritten"):
        write_simulation(scan, tmp_path / "scan.mcap")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(there, "precious")]


def test_a_failed_write_leaves_no_file(scan: SimulatedScan, tmp_path: Path) -> None:
    broken = SimulatedScan((*scan.views, scan.views[0]), scan.header, scan.truth)
    with pytest.raises(ValueError, match="view 0"):
        write_simulation(broken, tmp_path / "scan.mcap")
    assert list(tmp_path.iterdir()) == []


def test_the_truth_is_consistent(scene: StringScene) -> None:
    truth = scene_truth(scene, [], np.eye(4))
    curve = np.array(truth["curves"][0])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    # Chords of 2 mm in bends of at least 1 cm are shorter by at most (2/10)^2/24.
    assert np.diff(s) == pytest.approx(np.full(len(s) - 1, 0.002), rel=2e-3)
    assert s[-1] == pytest.approx(0.4, abs=3e-4)
    assert truth["radius"] == scene.radius_m
    for crossing in true_crossings(scene):
        places = [[np.interp(crossing[role][1], s, curve[:, k]) for k in range(3)] for role in ("over", "under")]
        for place in places:
            assert place[:2] == pytest.approx(crossing["point"][:2], abs=2e-4)
        assert places[0][2] - places[1][2] == pytest.approx(2 * scene.radius_m, rel=0.1)
        assert places[0][2] > crossing["point"][2] > places[1][2]


def test_a_table_elsewhere_moves_poses_and_truth_but_not_the_images() -> None:
    scene, camera = make_scene("loop", 1), camera_model("ideal", (64, 40))
    T_base_table = from_rotation_vector((0.0, 0.0, -0.006), (0.02, 0.01, 0.0))
    as_stated, elsewhere = simulate(scene, camera, 1), simulate(scene, camera, 1, T_base_table=T_base_table)
    for a, b in zip(as_stated.views, elsewhere.views, strict=True):
        assert np.array_equal(a.depth, b.depth)
    # The pose errors are drawn in the base frame, so a pose moves with the table up to twice its errors of some mm.
    moved = [T_base_table @ view.T_base_flange for view in as_stated.views]
    assert np.allclose([T[:3, 3] for T in moved], [view.T_base_flange[:3, 3] for view in elsewhere.views], atol=0.005)
    # Both truths are rounded to 0.1 micrometres.
    curve = transform_points(T_base_table, np.array(as_stated.truth["curves"][0]))
    assert np.allclose(curve, elsewhere.truth["curves"][0], atol=2e-7)
    point = transform_points(T_base_table, np.array([as_stated.truth["crossings"][0]["point"]]))[0]
    assert np.allclose(point, elsewhere.truth["crossings"][0]["point"], atol=1e-12)
    assert elsewhere.header.table_z_m == 0.0
