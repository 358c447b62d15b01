"""Height layers of exact depth images of a box on a table, and their median."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from cell.devices import View
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import make_scene
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import (
    CELL_M,
    MAX_EXTENT_M,
    MAX_MAP_M,
    HeightLayer,
    HeightMap,
    height_layer,
    merge_layers,
)
from recognition.preprocessing.target_cloud import Scene, preprocess

PARAMETERS = ChainParameters.for_radius(0.0042)
STRING = make_scene("straight", 1)
BOX = Box((0.05, -0.10), (0.04, 0.02, 0.003), 0.0)


@pytest.fixture(scope="module")
def scan() -> tuple[tuple[View, ...], Scene]:
    scan = simulate(replace(STRING, boxes=(BOX,)), camera_model("exact"), 1, PoseErrors().scaled(0.0), views=3)
    return scan.views, Scene(scan.header.table_z_m, scan.header.workspace_m)


def layers_of(views: tuple[View, ...], scene: Scene) -> list[HeightLayer]:
    return [height_layer(view, preprocess(view, PARAMETERS, scene), scene) for view in views]


def unmoved(layers: list[HeightLayer]) -> dict[int, np.ndarray]:
    return {layer.view: np.eye(4) for layer in layers}


def inside_box(heights: HeightMap, margin: float) -> np.ndarray:
    offset = np.abs(heights.cell_centres() - BOX.centre_m)
    return np.asarray((offset < np.array(BOX.size_m[:2]) / 2 - margin).all(axis=-1))


def test_a_low_box_and_the_table_have_their_heights(scan: tuple[tuple[View, ...], Scene]) -> None:
    layers = layers_of(*scan)
    heights = merge_layers(layers, unmoved(layers))
    # 0.1 mm: depths are whole tenths of a millimetre or less, and the alignment to the table plane averages them.
    np.testing.assert_allclose(heights.z_m[inside_box(heights, CELL_M)], BOX.size_m[2], rtol=0, atol=1e-4)
    centres = heights.cell_centres()
    to_string, _ = KDTree(STRING.curves[0][:, :2]).query(centres)
    away = ~inside_box(heights, -2 * CELL_M) & (np.abs(centres) < 0.2).all(axis=-1) & (to_string > 0.015)
    assert np.isfinite(heights.z_m[away]).all()
    np.testing.assert_allclose(heights.z_m[away], 0.0, rtol=0, atol=1e-4)
    (x0, x1), (y0, y1) = heights.extent_m
    assert scan[1].workspace_m is not None
    (left, right), (front, back), _ = scan[1].workspace_m
    assert x0 < left < right < x1
    assert y0 < front < back < y1


def test_the_registration_moves_a_layer_in_the_table_plane(scan: tuple[tuple[View, ...], Scene]) -> None:
    layers = layers_of(*scan)
    T = np.eye(4)
    T[:3, 3] = 2 * CELL_M, -CELL_M, 0.005
    moved = merge_layers(layers[:1], {layers[0].view: T}).z_m
    np.testing.assert_array_equal(moved[3:, :-2], merge_layers(layers[:1], unmoved(layers)).z_m[1:-2, 1:-1])


def test_the_median_rejects_one_wrong_view(scan: tuple[tuple[View, ...], Scene]) -> None:
    layers = layers_of(*scan)
    wrong = replace(layers[1], z_m=layers[1].z_m + np.float32(0.02))
    heights = merge_layers([layers[0], wrong, layers[2]], unmoved(layers))
    seen_by_all = np.isfinite([layer.z_m for layer in layers]).all(axis=0)
    low, high = np.fmin(layers[0].z_m, layers[2].z_m), np.fmax(layers[0].z_m, layers[2].z_m)
    assert (heights.z_m[seen_by_all] <= high[seen_by_all]).all()
    assert (heights.z_m[seen_by_all] >= low[seen_by_all]).all()
    # Unused views, as those that contradict the others, do not count.
    used = {layers[0].view: np.eye(4), layers[2].view: np.eye(4)}
    np.testing.assert_array_equal(
        merge_layers([layers[0], wrong, layers[2]], used).z_m, merge_layers([layers[0], layers[2]], used).z_m
    )


def test_without_a_workspace_the_map_is_where_the_cameras_look(scan: tuple[tuple[View, ...], Scene]) -> None:
    views, scene = scan
    layers = layers_of(views, Scene(scene.table_z_m))
    assert {layer.z_m.shape for layer in layers} <= {
        (n, m) for n in range(750, 753) for m in range(750, 753)
    }  # MAX_EXTENT_M / CELL_M, and parts of cells
    assert pytest.approx(1.5) == MAX_EXTENT_M
    heights = merge_layers(layers, unmoved(layers))
    np.testing.assert_allclose(heights.z_m[inside_box(heights, CELL_M)], BOX.size_m[2], rtol=0, atol=1e-4)


def test_a_view_without_depth_has_an_empty_layer(scan: tuple[tuple[View, ...], Scene]) -> None:
    views, scene = scan
    blank = replace(views[0], depth=np.zeros_like(views[0].depth))
    (layer,) = layers_of((blank,), scene)
    assert np.isnan(layer.z_m).all()
    assert np.isnan(merge_layers([layer], unmoved([layer])).z_m).all()
    assert merge_layers([], {}).z_m.shape == (0, 0)


def test_the_floor_beside_a_string_is_the_lower_side() -> None:
    x = np.arange(100) * CELL_M
    z = np.tile(np.where(x > 0.1, 0.004, 0.0), (100, 1)).T.astype(np.float32)
    heights = HeightMap(0.0, 0.0, CELL_M, z)
    positions = np.array([[0.05, 0.1], [0.1, 0.1], [0.15, 0.1], [0.5, 0.5]])
    np.testing.assert_allclose(heights.floor_beside(positions, 0.006), [0.0, 0.0, 0.004, np.nan], rtol=0, atol=1e-9)
    assert np.isnan(merge_layers([], {}).floor_beside(positions, 0.006)).all()


def test_peaks_are_the_highest_points_of_blocks() -> None:
    z = np.full((20, 20), 0.3, dtype=np.float32)
    z[3, 4], z[4, 4], z[12, 7], z[0, 0] = 0.35, 0.36, 0.34, np.nan
    z[15, 15] = 0.31
    peaks = HeightMap(0.1, -0.2, CELL_M, z).peaks(0.32, 5 * CELL_M)
    # two high cells are in one block of 5 x 5 cells, and one is lower than the limit
    expected = [[0.1 + 4.5 * CELL_M, -0.2 + 4.5 * CELL_M, 0.36], [0.1 + 12.5 * CELL_M, -0.2 + 7.5 * CELL_M, 0.34]]
    np.testing.assert_allclose(peaks, expected, rtol=0, atol=1e-7)
    assert HeightMap(0.1, -0.2, CELL_M, z).peaks(0.4, 0.01).shape == (0, 3)


def test_views_of_distant_places_do_not_make_a_large_map() -> None:
    """Three views look at one place and one looks 10 km farther: the map of both would need terabytes."""
    layer = HeightLayer(0, (100, -200), np.full((300, 300), 0.01, dtype=np.float32))
    layers = [replace(layer, view=view) for view in range(3)] + [replace(layer, view=3, first=(5_000_100, -200))]
    heights = merge_layers(layers, {view: np.eye(4) for view in range(4)})
    assert max(heights.z_m.shape) * CELL_M <= MAX_MAP_M
    near = merge_layers(layers[:3], {view: np.eye(4) for view in range(3)})
    i, j = (round((a - b) / CELL_M) for a, b in ((near.x_m, heights.x_m), (near.y_m, heights.y_m)))
    rows, columns = near.z_m.shape
    np.testing.assert_array_equal(heights.z_m[i : i + rows, j : j + columns], near.z_m)
