"""Coverage of the table by the views, and the message about uncovered parts."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.planning.look_at import look_at
from cell.simulation.offline_scan import WORKSPACE_HALF_M, SimulatedScan, simulate
from cell.simulation.pose_errors import viewpoints
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import SCENES, make_scene
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.coverage import (
    MAX_SQUARES,
    MIN_REPORTED_SHARE,
    CameraFrustum,
    Coverage,
    coverage_findings,
    coverage_message,
    table_coverage,
)
from recognition.preprocessing.target_cloud import Scene, preprocess
from recognition.request import RecognitionRequest

BOX = ((-0.12, 0.12), (-0.12, 0.12), (0.0, 0.12))
K = np.array([[400.0, 0.0, 319.5], [0.0, 400.0, 199.5], [0.0, 0.0, 1.0]])


def frustum(T_base_camera: NDArray[np.float64]) -> CameraFrustum:
    return CameraFrustum(K, 640, 400, T_base_camera)


def above(x: float, y: float, height_m: float) -> CameraFrustum:
    """Return the frustum of a camera that points straight down. The x axis of the image is the y axis of the base."""
    T = np.eye(4)
    T[:3, :3] = np.array([(0, 1, 0), (1, 0, 0), (0, 0, -1)])
    T[:3, 3] = x, y, height_m
    return frustum(T)


def coverage_of(view_count: NDArray[np.int64], side_m: float = 1.0) -> Coverage:
    return Coverage((0.0, side_m), (0.0, side_m), view_count)


def test_a_camera_straight_above_sees_a_rectangle() -> None:
    # 0.4 m above the table, 1 mm per pixel: 639 mm along y and 399 mm along x, about (0.1, -0.2).
    coverage = table_coverage([above(0.1, -0.2, 0.5)], (-0.5, 0.5), (-0.6, 0.6), 0.1)
    assert coverage.view_count.shape == (100, 120)
    x, y = -0.495 + 0.01 * np.arange(100), -0.595 + 0.01 * np.arange(120)
    expected = np.outer(np.abs(x - 0.1) <= 0.1995, np.abs(y + 0.2) <= 0.3195)
    np.testing.assert_array_equal(coverage.view_count, expected)
    assert coverage.covered_share == 0.0, "one view is not enough"


def test_oblique_views_are_counted_square_by_square() -> None:
    poses = [look_at(np.array([0.4, 0.1, -0.2]), azimuth, 0.8, 0.5, 0.3) for azimuth in (0.3, 2.0, 4.5)]
    coverage = table_coverage([frustum(T) for T in poses], (0.0, 0.9), (-0.5, 0.5), -0.2)
    x, y = np.meshgrid(0.005 + 0.01 * np.arange(90), -0.495 + 0.01 * np.arange(100), indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.2)])
    counted = np.zeros(len(places), dtype=np.int64)
    for T in poses:
        seen = transform_points(inverse(T), places)
        pixels = (seen @ K.T)[:, :2] / seen[:, 2:]
        counted += (seen[:, 2] > 0) & np.all((pixels >= 0) & (pixels <= (639, 399)), axis=1)
    np.testing.assert_array_equal(coverage.view_count.ravel(), counted)
    assert 0.1 < coverage.covered_share < 0.9


def test_the_table_behind_a_camera_is_not_in_its_view() -> None:
    up = above(0.0, 0.0, 0.5).T_base_camera @ np.diag([1.0, -1.0, -1.0, 1.0])
    assert table_coverage([frustum(up)] * 2, (-0.5, 0.5), (-0.5, 0.5), 0.0).covered_share == 0.0


def test_a_large_workspace_has_larger_squares() -> None:
    coverage = table_coverage([above(0.0, 0.0, 9.0)] * 2, (-5.0, 5.0), (0.0, 0.004), 0.0)
    assert coverage.view_count.shape == (MAX_SQUARES, 1)
    # At a height of 9 m a pixel has 22.5 mm, and 399 pixels are along x.
    assert coverage.covered_share == pytest.approx(399 * 0.0225 / 10, abs=2 / MAX_SQUARES)


def test_a_sliver_is_not_reported() -> None:
    view_count = np.full((100, 100), 8)
    assert coverage_message(coverage_of(view_count)) is None
    view_count[: round(100 * MIN_REPORTED_SHARE)] = 1
    assert coverage_message(coverage_of(view_count)) is None
    view_count[: round(100 * MIN_REPORTED_SHARE) + 1] = 1
    assert coverage_message(coverage_of(view_count)) is not None


def test_an_uncovered_corner_is_reported_with_its_position() -> None:
    view_count = np.full((100, 100), 2)
    view_count[80:, :30] = 1
    assert coverage_message(coverage_of(view_count)) == (
        "6 % of the table in the workspace (600 cm2) is in fewer than 2 views, and strings there may be missed or "
        "cut short; this part lies within x 0.80 to 1.00 m, y 0.00 to 0.30 m"
    )


def test_for_an_uncovered_border_the_covered_rectangle_is_reported() -> None:
    view_count = np.zeros((100, 100), dtype=np.int64)
    view_count[10:70, 20:90] = 3
    assert (coverage_message(coverage_of(view_count)) or "").endswith(
        "the largest covered rectangle is x 0.10 to 0.70 m, y 0.20 to 0.90 m"
    )


def test_the_reported_rectangle_is_covered() -> None:
    x, y = np.meshgrid(np.arange(100), np.arange(100), indexing="ij")
    coverage = coverage_of(np.where((x - 45) ** 2 + (y - 55) ** 2 < 40**2, 2, 0))
    message = coverage_message(coverage) or ""
    x0, x1, y0, y1 = (round(100 * float(figure)) for figure in re.findall(r"\d\.\d\d", message))
    assert coverage.is_covered[x0:x1, y0:y1].all()
    # The largest rectangle in a disc has 2 / pi of it; steps of 5 cm lose some.
    assert (x1 - x0) * (y1 - y0) > 0.8 * 2 * 40**2


def test_no_covered_square_or_no_covered_rectangle_has_a_message() -> None:
    nothing = coverage_message(coverage_of(np.zeros((40, 40), dtype=np.int64)))
    assert (nothing or "").endswith("this part is the whole table in the workspace")
    board = np.indices((100, 100)).sum(axis=0) % 2 * 2
    assert (coverage_message(coverage_of(board)) or "").endswith("this part is scattered over the table")


def test_coverage_takes_less_than_five_milliseconds() -> None:
    # The required limit for the largest grid and eight views, in processor time. The best of many runs counts, because
    # other processes share the core.
    frustums = [frustum(look_at(np.zeros(3), azimuth, 0.8, 0.3, 0.2)) for azimuth in np.arange(8.0)]
    spent_s = []
    for _ in range(100):
        begin_s = time.process_time()
        assert coverage_message(table_coverage(frustums, (-0.6, 0.6), (-0.6, 0.6), 0.0)) is not None
        spent_s.append(time.process_time() - begin_s)
    assert min(spent_s) < 0.005


@pytest.mark.parametrize("name", SCENES)
def test_simulated_scans_show_all_of_their_workspace(name: str) -> None:
    # With the defaults of `pointchain simulate`.
    camera, scene = camera_model("ideal"), make_scene(name, 0)
    points = np.vstack(scene.curves) if scene.curves else np.zeros((1, 3))
    size = (camera.width, camera.height)
    poses = viewpoints(points, camera.K, size, camera.near_m, camera.working_m, 8)
    half = max(WORKSPACE_HALF_M, float(np.abs(points[:, :2]).max()) + 0.03)
    frustums = [CameraFrustum(camera.K, *size, T) for T in poses]
    assert coverage_message(table_coverage(frustums, (-half, half), (-half, half), 0.0)) is None


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("loop", 1), camera_model("ideal", (320, 200)), 1, views=4)


def uncovered(scan: SimulatedScan, workspace_m: tuple[float, float] | None, views: slice = slice(4)) -> list[Finding]:
    box = None if workspace_m is None else (workspace_m, workspace_m, (0.0, 0.12))
    model = recognise(
        scan.views[views], RecognitionRequest(radius_m=scan.header.string_radius_m or 0.0042), Scene(0.0, box)
    ).model
    assert len(model.chains) == 1
    return [found for found in model.quality.findings if found.code == "table-not-covered"]


def test_a_model_has_a_doubt_about_the_part_that_its_views_do_not_show(scan: SimulatedScan) -> None:
    assert uncovered(scan, (-0.15, 0.15)) == []
    assert uncovered(scan, None) == [], "there is no workspace to cover"
    (doubt,) = uncovered(scan, (-0.6, 0.6))
    assert (doubt.severity, doubt.chains, doubt.limit) == ("doubt", (), MIN_REPORTED_SHARE)
    frustums = [CameraFrustum(view.K, 320, 200, view.T_base_camera) for view in scan.views]
    # Poses are corrected by a millimetre or two.
    share = table_coverage(frustums, (-0.6, 0.6), (-0.6, 0.6), 0.0).covered_share
    assert doubt.value == pytest.approx(1 - share, abs=0.01)
    assert float(doubt.message.split(" %")[0]) == pytest.approx(100 * (1 - share), abs=1.0)


def test_a_scan_of_one_view_covers_what_this_view_shows(scan: SimulatedScan) -> None:
    assert uncovered(scan, (-0.12, 0.12), views=slice(1, 2)) == []
    (doubt,) = uncovered(scan, (-0.6, 0.6), views=slice(1, 2))
    assert " is in no view, " in doubt.message
    blind = [replace(view, depth=np.zeros_like(view.depth)) for view in scan.views[2:3]]
    model = recognise([scan.views[1], *blind], RecognitionRequest(radius_m=0.0042), Scene(0.0, BOX)).model
    (doubt,) = (found for found in model.quality.doubts if found.code == "table-not-covered")
    assert "100 % of the table" in doubt.message, "a second view was to check the first one"


def test_a_missing_view_reduces_coverage(scan: SimulatedScan) -> None:
    every, fewer = (uncovered(scan, (-0.6, 0.6), slice(views))[0].value or 0.0 for views in (4, 2))
    assert fewer > every + 0.02


def test_only_views_that_show_something_count(scan: SimulatedScan, table_1: ChainParameters) -> None:
    scene = Scene(0.0, ((-0.15, 0.15), (-0.15, 0.15), (0.0, 0.12)))
    targets = [preprocess(view, table_1, scene) for view in scan.views]
    assert coverage_findings(targets, range(4), scene) == []
    # Views that were excluded although they saw something contradict the others.
    (doubt,) = coverage_findings(targets, [0], scene)
    assert (doubt.code, doubt.value) == ("table-not-covered", 1.0)
    assert doubt.message.startswith("100 %")
    # A view that saw only the table shows that no string is there.
    empty = [replace(target, points=np.zeros((0, 3))) for target in targets[1:]]
    assert coverage_findings([targets[0], *empty], [0], scene) == []
    blind = [replace(target, points=np.zeros((0, 3)), n_in_workspace=0) for target in targets[1:]]
    assert coverage_findings([targets[0], *blind], [0], scene) == [doubt]
