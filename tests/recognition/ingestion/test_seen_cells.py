"""What the views saw of each cell of the table, against the simulated scene and the poses of its cameras."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.ingestion.seen_cells import FREE_LEVELS_RADII, SeenCells, viewpoint_numbers
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.surface import Surface, observe

R = 0.0042


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    return simulate(make_scene("arc", 1), camera_model("ideal", (320, 200)), 1, views=4)


@pytest.fixture(scope="module")
def scene(scan: SimulatedScan) -> Scene:
    return Scene(0.0, scan.header.workspace_m)


@pytest.fixture(scope="module")
def surface(scan: SimulatedScan, scene: Scene) -> Surface:
    return observe(scan.views, scene, ChainParameters.for_radius(R))


@pytest.fixture(scope="module")
def from_string_m(scan: SimulatedScan, surface: Surface) -> NDArray[np.float64]:
    """Distance of the centre of each cell from the true centre line, seen from above."""
    distance, _ = KDTree(np.array(scan.truth["curves"][0])[:, :2]).query(centres(surface.seen))
    return np.asarray(distance)


def centres(seen: SeenCells) -> NDArray[np.float64]:
    rows, columns = (np.arange(n) + 0.5 for n in seen.viewpoints.shape)
    x, y = np.meshgrid(seen.x_m + rows * seen.cell_m, seen.y_m + columns * seen.cell_m, indexing="ij")
    return np.stack([x, y], axis=-1)


def test_every_cell_around_the_string_is_seen_from_all_viewpoints(
    surface: Surface, from_string_m: NDArray[np.float64]
) -> None:
    # All views show the middle of the scene. Beside the string, one or two of them look at its shadow.
    from_middle_m = np.linalg.norm(centres(surface.seen), axis=-1)
    around = (from_string_m < 4 * R) & (from_middle_m < 0.1)
    assert around.sum() > 100
    assert (surface.seen.viewpoints[around] >= 2).mean() > 0.98
    apart = (from_string_m > 5 * R) & (from_middle_m < 0.1)
    assert (surface.seen.viewpoints[apart] == 4).mean() > 0.9
    assert surface.seen.viewpoints.max() == 4


def test_views_from_one_position_are_one_viewpoint(scan: SimulatedScan, scene: Scene, surface: Surface) -> None:
    again = [replace(view, index=10 + view.index) for view in scan.views]
    twice = observe([*scan.views, *again], scene, ChainParameters.for_radius(R)).seen
    assert twice.viewpoints.max() == 4
    targets = surface.ingested.targets
    assert viewpoint_numbers([*targets, *targets[::-1]]) == [0, 1, 2, 3, 3, 2, 1, 0]


def test_the_pixels_per_radius_are_those_of_the_nearest_view(
    scan: SimulatedScan, surface: Surface, from_string_m: NDArray[np.float64]
) -> None:
    seen = surface.seen
    cells = np.argwhere(seen.viewpoints == 4)[::100]
    assert len(cells) > 5
    for i, j in cells:
        point = np.append(centres(seen)[i, j], 0.0)
        pixels = []
        for view in scan.views:
            T = view.T_base_camera
            depth_m = (point - T[:3, 3]) @ T[:3, 2]
            pixels.append(view.K[0, 0] * R / depth_m)
        # The reported poses are corrected by about a millimetre at half a metre.
        assert seen.pixels_per_radius[i, j] == pytest.approx(max(pixels), rel=0.01)


def test_the_noise_is_that_of_the_views(surface: Surface) -> None:
    noise_m = [target.scatter.pixel_m for target in surface.ingested.targets]
    by_all = surface.seen.noise_m[surface.seen.viewpoints == 4]
    np.testing.assert_allclose(by_all, np.sqrt(np.mean(np.square(noise_m))), rtol=1e-9)


def test_a_cell_that_no_view_shows_is_unseen(surface: Surface) -> None:
    seen = surface.seen
    unseen = seen.viewpoints == 0
    assert unseen.any()
    assert np.isnan(seen.noise_m[unseen]).all()
    assert (seen.pixels_per_radius[unseen] == 0).all()


def test_the_space_over_the_table_is_free_and_that_over_the_string_from_its_top_on(
    surface: Surface, from_string_m: NDArray[np.float64]
) -> None:
    seen = surface.seen
    bare = (from_string_m > 5 * R) & (seen.viewpoints == 4)
    assert (seen.free_above_m[bare] == FREE_LEVELS_RADII[0] * R).mean() > 0.99
    middle = from_string_m < 0.3 * R
    # The string fills the space up to 2 r, and some pixels at its rims have the depth of the table.
    assert (seen.free_above_m[middle] >= 2 * R).mean() > 0.95
    assert (seen.free_above_m[middle] <= 3 * R).mean() > 0.95


def empty_table(view: View) -> View:
    """Return the view of an empty table at z = 0."""
    T = view.T_base_camera
    v, u = np.indices(view.depth.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(view.K).T @ T[:3, :3].T
    return replace(view, depth=np.rint(-T[2, 3] / rays[..., 2] / view.depth_unit_m).astype(np.uint16))


def test_an_empty_table_is_seen_too(scan: SimulatedScan, scene: Scene) -> None:
    surface = observe(map(empty_table, scan.views), scene, ChainParameters.for_radius(R))
    assert surface.no_string_reason is not None
    assert len(surface.points) == 0
    # At the border of an image, points above the table are outside.
    seen = surface.seen.viewpoints == 4
    assert seen.mean() > 0.2
    assert (surface.seen.free_above_m[seen] == FREE_LEVELS_RADII[0] * R).all()
