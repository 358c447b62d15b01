"""Ingestion of views one by one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.errors import DuplicateViewError, TableElsewhereError, TooCrowdedError
from recognition.ingestion import table_and_warp, view_ingestion
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.ingestion.view_ingestion import ingest_views
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.correspondences import Correspondences, compared_views


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, views=3)


@pytest.fixture(scope="module")
def scene(scan: SimulatedScan) -> Scene:
    return Scene(0.0, scan.header.workspace_m)


def test_each_view_is_paired_with_those_before_it(scan: SimulatedScan, scene: Scene, table_1: ChainParameters) -> None:
    ingested = ingest_views(iter(scan.views), table_1, scene)
    assert [target.view for target in ingested.targets] == [cloud.view for cloud in ingested.clouds] == [0, 1, 2]
    assert [(pair.source_view, pair.target_view) for pair in ingested.correspondences] == [(1, 0), (2, 0), (2, 1)]
    assert (ingested.excluded, ingested.no_string_reason) == ((), None)
    for cloud, target in zip(ingested.clouds, ingested.targets, strict=True):
        np.testing.assert_array_equal(cloud.T_correction, target.T_table_alignment)
        assert cloud.image is target.image is scan.views[cloud.view]


def test_a_further_view_is_paired_with_the_nearest_of_those_before_it(table_1: ChainParameters) -> None:
    scan = simulate(make_scene("arc", 1), camera_model("exact", (160, 100)), 1, views=12)
    arrived = [scan.views[k] for k in np.random.default_rng(0).permutation(12)]
    ingested = ingest_views(arrived, table_1, Scene(0.0, scan.header.workspace_m))
    assert [cloud.view for cloud in ingested.clouds] == [view.index for view in arrived]
    position = {cloud.view: k for k, cloud in enumerate(ingested.clouds)}
    found = {(position[pair.source_view], position[pair.target_view]) for pair in ingested.correspondences}
    # All views of this scene overlap.
    assert found == set(zip(*np.nonzero(np.tril(compared_views(ingested.clouds))), strict=True))
    assert len(found) == 28 + 4 * 4


def test_a_view_is_ingested_before_the_next_is_requested(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []

    def arriving() -> Iterator[View]:
        for view in scan.views:
            events.append(f"view {view.index} taken")
            yield view

    work = view_ingestion.find_correspondences

    def watched(
        cloud: NormalCloud, others: Sequence[NormalCloud], parameters: ChainParameters
    ) -> list[Correspondences]:
        events.append(f"view {cloud.view} paired with {len(others)}")
        return work(cloud, others, parameters)

    monkeypatch.setattr(view_ingestion, "find_correspondences", watched)
    ingest_views(arriving(), table_1, scene)
    assert events == [line for k in range(3) for line in (f"view {k} taken", f"view {k} paired with {k}")]


def test_views_need_different_indices(scan: SimulatedScan, scene: Scene, table_1: ChainParameters) -> None:
    with pytest.raises(DuplicateViewError, match="two views have the index 1") as caught:
        ingest_views([*scan.views, replace(scan.views[2], index=1)], table_1, scene)
    assert caught.value.slug == "duplicate-view"


def crowded(view: View) -> View:
    """Return the view in fine pixels with the table raised by 50 mm."""
    T, K = view.T_base_camera, view.K * np.array([[4.0], [4.0], [1.0]])
    v, u = np.indices((800, 1280))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T @ T[:3, :3].T
    depth = (0.05 - T[2, 3]) / rays[..., 2] / view.depth_unit_m
    return replace(view, depth=depth.astype(np.uint16), K=K, intensity=None)


def test_one_crowded_view_is_excluded_and_most_are_an_error(
    scan: SimulatedScan, scene: Scene, table_1: ChainParameters
) -> None:
    first, second, third = scan.views
    ingested = ingest_views([first, crowded(second), third], table_1, scene)
    assert [cloud.view for cloud in ingested.clouds] == [0, 2]
    (quality,) = ingested.excluded
    assert (quality.index, quality.used, quality.code) == (1, False, "view-crowded")
    assert quality.reason is not None
    assert "points above the table, more than 100000" in quality.reason
    with pytest.raises(TooCrowdedError):
        ingest_views([first, crowded(second), crowded(third)], table_1, scene)
    with pytest.raises(TooCrowdedError):
        ingest_views([first, crowded(second)], table_1, scene)


def on_table(height_m: float, tilt_deg: float = 0.0, views: int = 4) -> SimulatedScan:
    """Return a scan of an arc on a table at a height, tilted about x."""
    T = from_rotation_vector((0, 0, height_m), (np.deg2rad(tilt_deg), 0, 0))
    return simulate(make_scene("arc", 1), camera_model("ideal", (320, 200)), 1, views=views, T_base_table=T)


def warped(amplitude_per_m: float) -> list[View]:
    """Return five views of an arc whose inverse depth is curved along the rows of the image."""
    views = simulate(make_scene("arc", 1), camera_model("ideal", (320, 200)), 1, views=5).views
    curved = amplitude_per_m * np.linspace(-1, 1, 320) ** 2
    counts = [view.depth / (1 + view.depth * view.depth_unit_m * curved) for view in views]
    return [replace(view, depth=np.rint(c).astype(np.uint16)) for view, c in zip(views, counts, strict=True)]


def test_views_are_preprocessed_again_without_the_warp_of_the_camera(scene: Scene, table_1: ChainParameters) -> None:
    views = warped(0.02)
    ingested = ingest_views(iter(views), table_1, scene)
    assert ingested.measured.warp is not None
    assert ingested.measured.views == views
    assert [target.view for target in ingested.targets] == [0, 1, 2, 3, 4]
    assert all(target.image is not view for target, view in zip(ingested.targets, views, strict=True))
    straight = ingest_views(warped(0.0), table_1, scene)
    assert straight.measured.warp is None
    # Parts of the table at the sides are above the threshold, or their views are tilted, unless the warp is corrected.
    sizes, expected = (np.array([len(target.points) for target in x.targets]) for x in (ingested, straight))
    np.testing.assert_allclose(sizes, expected, rtol=0.1)
    corrected = [ingested.measured.corrected(number) for number in range(5)]
    assert TableAndWarp.measure(corrected, scene).warp is None


def test_an_earlier_ingestion_keeps_its_warp(scene: Scene, table_1: ChainParameters) -> None:
    views = warped(0.02)
    earlier = ingest_views(views[:4], table_1, scene)
    assert earlier.measured.warp is not None
    continued = ingest_views(views, table_1, scene, earlier)
    whole = ingest_views(views, table_1, scene)
    assert continued.measured.warp is not None
    assert whole.measured.warp is not None
    np.testing.assert_array_equal(continued.measured.warp.coefficients, whole.measured.warp.coefficients)
    for a, b in zip(continued.targets, whole.targets, strict=True):
        np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(-0.006, 0.0), (0.006, 0.0), (0.0, 1.0)])
def test_views_are_preprocessed_with_the_table_where_they_show_it(
    scene: Scene, table_1: ChainParameters, height_m: float, tilt_deg: float
) -> None:
    lifted = on_table(height_m, tilt_deg)
    ingested = ingest_views(lifted.views, table_1, scene)
    table = ingested.moved_table
    assert table is not None
    assert table.height_m == pytest.approx(height_m, abs=0.002)
    assert np.degrees(table.tilt_rad) == pytest.approx(tilt_deg, abs=0.2)
    assert ingested.excluded == ()
    T = inverse(table.T_base_table)
    for target, view in zip(ingested.targets, lifted.views, strict=True):
        # a string, and not the table
        assert 50 < len(target.points) < 0.2 * target.n_in_workspace
        assert target.points[:, 2].min() > table_1.z_t
        # what is left to align is a pose error of this view
        np.testing.assert_allclose(target.T_base_camera[:3, 3], (T @ view.T_base_camera)[:3, 3], atol=0.004)


@pytest.mark.parametrize("table_z_m", [0.06, 0.3])
@pytest.mark.parametrize("views", [1, 3])
def test_views_of_nothing_near_the_given_table_are_refused(
    scan: SimulatedScan, table_1: ChainParameters, views: int, table_z_m: float
) -> None:
    """All that the views show is far below the given table, so they show neither a string nor a bare table."""
    scene = Scene(table_z_m, ((-0.15, 0.15), (-0.15, 0.15), (-0.1, table_z_m + 0.12)))
    with pytest.raises(TableElsewhereError, match=r"no table within 50 mm of z = 0\.\d+ m: .* at z = -?0\.00\d m"):
        ingest_views(scan.views[:views], table_1, scene)


def test_a_table_where_it_is_given_changes_nothing(scan: SimulatedScan, scene: Scene, table_1: ChainParameters) -> None:
    ingested = ingest_views(scan.views, table_1, scene)
    assert ingested.moved_table is None
    np.testing.assert_array_equal(ingested.measured.T_base_table, np.eye(4))
    assert len(ingested.measured.planes) == 3
    for number, view in enumerate(scan.views):
        assert ingested.measured.corrected(number) is view


def test_views_of_a_lower_table_may_arrive_later(scene: Scene, table_1: ChainParameters) -> None:
    views = on_table(-0.006).views
    first = ingest_views(views[:2], table_1, scene)
    assert first.moved_table is not None
    continued, at_once = ingest_views(views, table_1, scene, first), ingest_views(views, table_1, scene)
    assert continued.moved_table is not None
    assert at_once.moved_table is not None
    np.testing.assert_array_equal(continued.moved_table.offset, at_once.moved_table.offset)
    assert [cloud.view for cloud in continued.clouds] == [0, 1, 2, 3]
    np.testing.assert_array_equal(continued.clouds[3].points, at_once.clouds[3].points)
    assert continued.measured.views == [*views]


def test_a_table_beyond_the_limits_is_refused(scene: Scene, table_1: ChainParameters) -> None:
    with pytest.raises(TableElsewhereError, match=r"the table (29|30)\.[0-9] mm lower than given and tilted by 0\."):
        ingest_views(on_table(-0.03).views, table_1, scene)
    with pytest.raises(TableElsewhereError, match=r"the table (29|30)\.[0-9] mm higher"):
        TableAndWarp.measure(on_table(0.03).views, scene)


def test_views_are_given_relative_to_the_measured_table(scene: Scene) -> None:
    tilted = TableAndWarp.measure(on_table(0.0, 1.0).views, scene)
    moved = [tilted.corrected(number) for number in range(4)]
    again = TableAndWarp.measure(moved, scene)
    assert [again.corrected(number) for number in range(4)] == moved


def test_table_and_warp_are_measured_once_for_all_radii(
    scene: Scene, table_1: ChainParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recognition with another radius preprocesses the views again, with the same table and warp."""
    views = warped(0.02)
    first = ingest_views(views, table_1, scene)
    monkeypatch.setattr(table_and_warp, "measure_table", None)  # a call would fail
    monkeypatch.setattr(table_and_warp, "sample_table", None)
    thinner = ChainParameters.for_radius(0.003)
    for earlier in (first, first.measured):
        again = ingest_views(views, thinner, scene, earlier)
        assert again.parameters == thinner
        assert again.measured.warp is first.measured.warp
        assert [target.threshold_m for target in again.targets] == [thinner.z_t] * 5
    continued = ingest_views(views, table_1, scene, first)
    assert list(continued.targets) == list(first.targets)
