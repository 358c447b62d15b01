"""Recognition from end to end on a small simulated scan: one loop, three noiseless views whose poses are off."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from calibration.geometry.transforms import from_rotation_vector, transform_points
from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.errors import InsufficientViewsError, InvalidParametersError, NoDepthError
from recognition.geometry.polyline import points_at
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.model.model import METHODS, Method, PointChainModel
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from recognition.result import Recognition
from recognition.stage_timer import stages_of
from recognition.tracing.fragments import Fragment, link_nodes
from recognition.tracing.nodes import CentreLineNodes

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, views=3)


@pytest.fixture(scope="module")
def scene(scan: SimulatedScan) -> Scene:
    return Scene(scan.header.table_z_m or 0.0, scan.header.workspace_m)


@pytest.fixture(scope="module")
def result(scan: SimulatedScan, scene: Scene, table_1: ChainParameters) -> Callable[[Method], Recognition]:
    results = {
        method: recognise(scan.views, RecognitionRequest(method=method, radius_m=table_1.r), scene)
        for method in METHODS
    }
    return lambda method: results[method]


def empty_table(view: View) -> View:
    """Return the view of an empty table at z = 0."""
    T = view.T_base_camera
    v, u = np.indices(view.depth.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(view.K).T @ T[:3, :3].T
    depth = np.rint(-T[2, 3] / rays[..., 2] / view.depth_unit_m)
    return replace(view, depth=depth.astype(np.uint16))


def document(recognition: Recognition) -> dict[str, Any]:
    """Return the JSON document of the model, written and read back, without the times, which differ from run to run."""
    written = json.dumps(recognition.model.to_json(), allow_nan=False)
    read_back = json.loads(written, parse_float=lambda figure: round(float(figure), 9))
    del read_back["timing_s"]
    return read_back


def doubts_but_coverage(model: PointChainModel) -> list[Finding]:
    """Return all doubts but that about the table: three views do not show the whole workspace."""
    return [found for found in model.quality.doubts if found.code != "table-not-covered"]


def runs_backwards(chain: Chain, scan: SimulatedScan) -> bool:
    """Return whether a chain begins at the last end of the true string."""
    ends = np.array(scan.truth["curves"][0])[[0, -1]]
    return bool(np.linalg.norm(ends - chain.points[0], axis=1).argmin() == 1)


def test_the_enhanced_method_finds_the_loop(scan: SimulatedScan, result: Callable[[Method], Recognition]) -> None:
    model = result("enhanced").model
    (chain,), (curve,) = model.chains, scan.truth["curves"]
    assert not chain.closed
    assert chain.ends == ("free", "free")
    # 0.4 m; ends may be a chain point short, and links cut corners.
    assert chain.length_m == pytest.approx(0.4, abs=0.01)
    truth = np.array(curve)
    distance, _ = KDTree(truth).query(chain.points)
    # Simulated poses are off by a millimetre in all; the curve is given every 2 mm. Bridged points may be worse.
    assert distance[chain.views > 0].mean() < 0.0015
    assert distance.max() < 0.005
    # All of the string is covered.
    assert KDTree(chain.points).query(truth)[0].max() < 0.008
    spacing = np.linalg.norm(np.diff(chain.points, axis=0), axis=1)
    assert spacing.max() < 2.1 * model.parameters.r_n
    assert chain.views.max() == 3


def test_the_crossing_is_measured(scan: SimulatedScan, result: Callable[[Method], Recognition]) -> None:
    model = result("enhanced").model
    (crossing,), (true,) = model.crossings, scan.truth["crossings"]
    np.testing.assert_allclose(crossing.point[:2], true["point"][:2], rtol=0, atol=0.002)
    s_over, s_under = true["over"][1], true["under"][1]
    if runs_backwards(model.chains[0], scan):
        s_over, s_under = 0.4 - s_over, 0.4 - s_under
    assert crossing.over.s_m == pytest.approx(s_over, abs=0.01)
    assert crossing.under.s_m == pytest.approx(s_under, abs=0.01)
    # 2 r at the crossing itself. It is measured beside the crossing, where the strands are closer.
    assert 0.5 * 0.0084 < crossing.gap_m < 1.1 * 0.0084
    assert crossing.confidence > 0.99
    assert doubts_but_coverage(model) == []
    roles = [entry[1] for entry in model.gauss_code()[0]]
    assert roles == (["over", "under"] if s_over < s_under else ["under", "over"])


def test_the_graph_method_is_the_default_and_finds_the_loop_better(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, result: Callable[[Method], Recognition]
) -> None:
    recognition = result("graph")
    assert document(recognise(scan.views, RecognitionRequest(radius_m=table_1.r), scene)) == document(recognition)
    model = recognition.model
    assert model.method == "graph"
    (chain,), (curve,) = model.chains, scan.truth["curves"]
    assert (chain.closed, chain.ends, chain.radius_m) == (False, ("free", "free"), table_1.r)
    # Both ends are localised, so that the whole 0.4 m are found.
    assert chain.length_m == pytest.approx(0.4, abs=0.0015)
    truth = np.array(curve)
    ends = np.linalg.norm(chain.points[[0, -1]][:, None] - truth[[0, -1]], axis=2)
    assert ends.min(axis=1).max() < 0.0015
    # Simulated pose errors are a millimetre. Alignment to the table and the mean of three views leave a few tenths.
    dense = np.column_stack([np.interp(np.linspace(0, 1, 4001), np.linspace(0, 1, len(truth)), k) for k in truth.T])
    distance, _ = KDTree(dense).query(chain.points)
    assert distance.mean() < 0.0004
    assert distance.max() < 0.0008
    # The whole scan may be off to one side, but not by three sigma.
    assert (distance < 3 * chain.sigma_m).all()
    assert KDTree(chain.points).query(truth)[0].max() < 0.7 * table_1.r_n
    assert chain.views.max() == 3
    steps = np.linalg.norm(np.diff(chain.points, axis=0), axis=1)
    assert steps.max() < 1.5 * table_1.r_n
    assert recognition.stages.graph is not None
    assert recognition.stages.refinement is not None
    assert recognition.stages.reconstruction is None


def test_the_graph_method_measures_the_crossing(scan: SimulatedScan, result: Callable[[Method], Recognition]) -> None:
    model = result("graph").model
    (crossing,), (true,) = model.crossings, scan.truth["crossings"]
    np.testing.assert_allclose(crossing.point[:2], true["point"][:2], rtol=0, atol=0.002)
    s_over, s_under = true["over"][1], true["under"][1]
    if runs_backwards(model.chains[0], scan):
        s_over, s_under = 0.4 - s_over, 0.4 - s_under
    assert crossing.over.s_m == pytest.approx(s_over, abs=0.004)
    assert crossing.under.s_m == pytest.approx(s_under, abs=0.004)
    # Bridged smoothly, the hidden strand is where it is: 2 r below, to a fifth of that.
    assert crossing.gap_m == pytest.approx(0.0084, rel=0.2)
    assert crossing.confidence > 0.99
    assert doubts_but_coverage(model) == []


def test_the_radius_is_measured_if_it_is_not_given(scan: SimulatedScan, scene: Scene) -> None:
    model = recognise(scan.views, scene=scene).model
    assert model.parameters.r == pytest.approx(0.0042, rel=0.05)
    assert len(model.chains) == len(model.crossings) == 1


def test_a_string_much_thinner_than_the_given_radius_gives_a_doubt(scan: SimulatedScan, scene: Scene) -> None:
    # The radius is 4.2 mm and 6 mm is given: the chain has the true radius, but parts of it may be missing.
    model = recognise(scan.views, RecognitionRequest(radius_m=0.006), scene).model
    assert model.chains[0].radius_m == pytest.approx(0.0042, rel=0.1)
    doubt = next(found for found in model.quality.doubts if found.code == "radius-much-smaller")
    assert doubt.chains == (0,)
    assert (doubt.value, doubt.limit) == (pytest.approx(0.0042, rel=0.1), 0.006)
    assert not model.trusted(0)
    # If 3 mm is given, the string is found whole, and a note reports its radius.
    model = recognise(scan.views, RecognitionRequest(radius_m=0.003), scene).model
    assert doubts_but_coverage(model) == []
    note = next(found for found in model.quality.findings if found.code == "radius-larger")
    assert note.chains == (0,)
    assert (note.value, note.limit) == (pytest.approx(0.0042, rel=0.1), 0.003)
    assert model.trusted(0)
    assert len(model.crossings) == 1


def test_the_previous_method_gives_a_model_of_its_own(
    scan: SimulatedScan, result: Callable[[Method], Recognition]
) -> None:
    recognition = result("matching")
    assert recognition.model.method == "matching"
    assert (recognition.stages.thinned, recognition.stages.enhanced, recognition.stages.reconstruction) == (
        None,
        None,
        None,
    )
    points = np.vstack([chain.points for chain in recognition.model.chains])
    distance, _ = KDTree(np.array(scan.truth["curves"][0])).query(points)
    # It links points of the centre line cloud, which all lie near the string.
    assert distance.max() < 0.005
    # Without restarts and reconstruction the string comes in pieces at its crossing.
    assert len(recognition.model.chains) > 1


@pytest.mark.parametrize("method", METHODS)
def test_stages_are_reported_in_order_and_timed(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, method: Method
) -> None:
    reported: list[str] = []
    model = recognise(
        scan.views, RecognitionRequest(method=method, radius_m=table_1.r), scene, on_stage=reported.append
    ).model
    assert tuple(reported) == stages_of(method)
    assert tuple(model.timing_s) == stages_of(method)
    assert all(seconds >= 0 for seconds in model.timing_s.values())


def test_waiting_for_a_view_is_not_counted_as_work(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, result: Callable[[Method], Recognition]
) -> None:
    wait_s = 0.3

    def as_they_come() -> Iterator[View]:
        for view in scan.views:
            time.sleep(wait_s)
            yield view

    began = time.perf_counter()
    recognition = recognise(as_they_come(), RecognitionRequest(radius_m=table_1.r), scene)
    taken_s = time.perf_counter() - began
    assert document(recognition) == document(result("graph"))
    assert sum(recognition.model.timing_s.values()) <= taken_s - len(scan.views) * wait_s


@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_the_same_model(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, result: Callable[[Method], Recognition], method: Method
) -> None:
    # From an iterator, as a scan or a replay delivers its views.
    again = recognise(iter(scan.views), RecognitionRequest(method=method, radius_m=table_1.r), scene)
    assert document(again) == document(result(method))


def test_the_results_of_the_stages_are_kept(scan: SimulatedScan, result: Callable[[Method], Recognition]) -> None:
    recognition = result("enhanced")
    assert [target.view for target in recognition.targets] == [0, 1, 2]
    assert [cloud.view for cloud in recognition.surface.ingested.clouds] == [0, 1, 2]
    for kept in (
        recognition.registration,
        recognition.stages.centre_line,
        recognition.stages.thinned,
        recognition.stages.enhanced,
        recognition.stages.reconstruction,
    ):
        assert kept is not None
    assert sum(map(len, recognition.stages.segments)) > 30
    assert [(view.index, view.used) for view in recognition.model.quality.views] == [(0, True), (1, True), (2, True)]
    for target, view in zip(recognition.targets, scan.views, strict=True):
        assert target.n_measured == np.count_nonzero(view.depth)


def test_a_scan_moved_on_the_table_gives_the_model_moved(table_1: ChainParameters) -> None:
    exact = simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, errors=NO_ERRORS, views=3)
    T_moved = from_rotation_vector((0.3, -0.2, 0.0), (0, 0, 0.2))
    moved_views = [replace(view, T_base_flange=T_moved @ view.T_base_flange) for view in exact.views]
    before = recognise(exact.views, RecognitionRequest(radius_m=table_1.r), Scene()).model
    after = recognise(moved_views, RecognitionRequest(radius_m=table_1.r), Scene()).model
    assert after.gauss_code() == before.gauss_code()
    assert len(after.gauss_code()[0]) == 2
    assert after.chains[0].ends == before.chains[0].ends
    # The table plane is fitted again and the voxels differ: tenths of a millimetre across the string.
    line = transform_points(T_moved, before.chains[0].points)
    dense = np.vstack([np.linspace(a, b, 20) for a, b in pairwise(line)])
    distance, _ = KDTree(dense).query(after.chains[0].points)
    assert distance.max() < 0.0005
    assert after.chains[0].length_m == pytest.approx(before.chains[0].length_m, abs=0.0015)
    crossing = transform_points(T_moved, before.crossings[0].point[None])[0]
    np.testing.assert_allclose(after.crossings[0].point, crossing, rtol=0, atol=0.0005)


@pytest.mark.parametrize("method", METHODS)
def test_no_string_is_a_valid_empty_model(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, method: Method
) -> None:
    reported: list[str] = []
    recognition = recognise(
        map(empty_table, scan.views),
        RecognitionRequest(method=method, radius_m=table_1.r),
        scene,
        on_stage=reported.append,
    )
    empty = document(recognition)
    assert (empty["chains"], empty["crossings"], empty["grasps"]) == ([], [], [])
    assert empty["topology"] == {"gauss_code": [], "p_data": {"elements": [], "matrix": []}}
    # Three views do not show the whole workspace.
    uncovered, nothing = empty["quality"]["findings"]
    assert (nothing["code"], nothing["severity"]) == ("no-string-in-view", "note")
    assert nothing["message"].startswith("no string of this radius in view")
    assert (uncovered["code"], uncovered["severity"]) == ("table-not-covered", "doubt")
    assert "is in fewer than 2 views" in uncovered["message"]
    assert empty["quality"]["verdict"] == "review"
    assert [view["used"] for view in empty["quality"]["views"]] == [False, False, False]
    assert reported == ["preprocess"]
    assert list(recognition.model.timing_s) == ["preprocess"]


def test_a_view_without_depth_is_excluded_and_reported(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters
) -> None:
    views = [scan.views[0], replace(scan.views[1], depth=np.zeros_like(scan.views[1].depth)), scan.views[2]]
    model = recognise(views, RecognitionRequest(radius_m=table_1.r), scene).model
    assert [view.used for view in model.quality.views] == [True, False, True]
    assert (model.quality.views[1].code, model.quality.views[1].reason) == (
        "view-without-depth",
        "no pixel has a depth",
    )
    (note,) = (found for found in model.quality.findings if found.view is not None)
    assert (note.code, note.severity, note.view) == ("view-without-depth", "note", 1)
    assert len(model.chains) >= 1


def test_a_single_view_gives_a_model_with_a_larger_sigma(table_1: ChainParameters) -> None:
    camera = camera_model("exact", (320, 200))
    scan = simulate(make_scene("loop", 1), camera, 1, views=3, workspace_half_m=0.12)
    shown = Scene(0.0, scan.header.workspace_m)
    all_views, one_view = (
        recognise(views, RecognitionRequest(radius_m=table_1.r), shown).model for views in (scan.views, scan.views[1:2])
    )
    assert one_view.gauss_code() == all_views.gauss_code()
    assert one_view.quality.verdict == "accept"
    (chain,), (usual,) = one_view.chains, all_views.chains
    assert set(chain.views.tolist()) == {0, 1}, "the lower strand is hidden at the crossing"
    assert np.median(chain.sigma_m) > 2 * np.median(usual.sigma_m)
    (note,) = (found for found in one_view.quality.findings if found.code == "single-view")
    assert (note.severity, note.view) == ("note", 1)
    assert "single-view" not in {found.code for found in all_views.quality.findings}
    (view,) = one_view.quality.views
    assert (view.used, view.fitness, view.rms_m) == (True, None, None)


def test_ends_that_a_single_view_hides_are_unobserved(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters
) -> None:
    # This view is oblique and coarse. It hides so much of the lower strand that its two parts are not joined.
    model = recognise(scan.views[:1], RecognitionRequest(radius_m=table_1.r), scene).model
    assert sorted(chain.ends for chain in model.chains) == [("free", "unobserved"), ("unobserved", "free")]
    assert model.quality.verdict == "review"
    assert [found.code for found in model.quality.doubts].count("end-unobserved") == 2


def test_no_views_and_views_without_depth_are_errors(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters
) -> None:
    with pytest.raises(InsufficientViewsError, match="no view was given"):
        recognise([], RecognitionRequest(radius_m=table_1.r), scene)
    blind = [replace(view, depth=np.zeros_like(view.depth)) for view in scan.views]
    with pytest.raises(NoDepthError, match="no view measured anything in the workspace"):
        recognise(blind, RecognitionRequest(radius_m=table_1.r), scene)
    with pytest.raises(NoDepthError, match="view 0: no pixel has a depth"):
        recognise(blind[:1], RecognitionRequest(radius_m=table_1.r), scene)
    saturated = [replace(view, depth=np.full_like(view.depth, 65535)) for view in scan.views]
    with pytest.raises(NoDepthError, match="no view measured anything in the workspace"):
        recognise(saturated, RecognitionRequest(radius_m=table_1.r), scene)


@pytest.mark.parametrize("r", [0.001, 0.0042, 0.012])
def test_a_wrong_radius_still_gives_a_finite_model(scan: SimulatedScan, scene: Scene, r: float) -> None:
    for method in METHODS:
        model = document(recognise(scan.views, RecognitionRequest(method=method, radius_m=r), scene))
        assert model["parameters"]["r_m"] == r
        for chain in model["chains"]:
            lengths = {len(chain[name]) for name in ("points", "arc_length_m", "sigma_m", "views")}
            assert len(lengths) == 1


def test_an_unknown_method_is_refused(scan: SimulatedScan, scene: Scene) -> None:
    with pytest.raises(InvalidParametersError, match="no method 'grpah'; it must be one of matching, enhanced, graph"):
        recognise(scan.views, RecognitionRequest("grpah"), scene)  # type: ignore[arg-type]  # the name is refused


def test_an_end_behind_which_string_was_lost_is_unobserved_and_reported(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = np.array(scan.truth["curves"][0][0])

    def without_its_first_40_mm(nodes: CentreLineNodes, parameters: ChainParameters) -> list[Fragment]:
        fragments = []
        for fragment in link_nodes(nodes, parameters):
            kept = np.linalg.norm(fragment.points - first, axis=1) > 0.04
            fragments += fragment.split(kept, np.zeros(len(kept), dtype=bool))
        return fragments

    monkeypatch.setattr("recognition.tracing.trace.link_nodes", without_its_first_40_mm)
    model = recognise(scan.views, RecognitionRequest(radius_m=table_1.r), scene).model
    (chain,) = model.chains
    assert chain.length_m < 0.39
    nearer = int(np.argmin(np.linalg.norm(chain.points[[0, -1]] - first, axis=1)))
    assert (chain.ends[nearer], chain.ends[1 - nearer]) == ("unobserved", "free")
    assert any(found.code == "unexplained-surface" for found in model.quality.findings)
    (doubt,) = (found for found in model.quality.doubts if found.code == "end-unobserved")
    assert (doubt.chains, doubt.end) == ((0,), ("first", "last")[nearer])
    assert not model.trusted(0, nearer * chain.length_m)
    assert model.trusted(0, (1 - nearer) * chain.length_m)


@pytest.mark.parametrize(("name", "seed"), [("several", 2), ("ring", 4), ("random", 3)])
def test_scanning_an_unmoved_scene_again_gives_the_same_ids_directions_and_codes(
    table_1: ChainParameters, name: str, seed: int
) -> None:
    models = []
    for again in range(3):
        # Other noise, and other errors of the poses and of the calibration.
        scan = simulate(make_scene(name, seed), camera_model("ideal", (320, 200)), again, views=6)
        models.append(
            recognise(scan.views, RecognitionRequest(radius_m=table_1.r), Scene(0.0, scan.header.workspace_m)).model
        )
    first = models[0]
    assert first.crossings
    for model in models[1:]:
        assert model.gauss_code() == first.gauss_code()
        for chain, before in zip(model.chains, first.chains, strict=True):
            # The errors of the poses shift a scan by up to a millimetre, and an end is found within a radius. A chain
            # that runs the other way, or a ring that begins elsewhere, is off by centimetres.
            assert np.linalg.norm(chain.points[0] - before.points[0]) < table_1.r
            middle, middle_before = (points_at(one.points, np.array([0.1]))[0] for one in (chain, before))
            assert np.linalg.norm(middle - middle_before) < table_1.r
