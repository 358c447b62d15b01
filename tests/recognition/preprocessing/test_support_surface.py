"""What a string rests on, from height maps with known objects, and whole models of strings on plates."""

from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import make_scene
from recognition.pipeline import recognise
from recognition.preprocessing.height_map import CELL_M, HeightMap
from recognition.preprocessing.support_surface import MAX_DISTANCE_M, SupportSurface
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from tests.recognition.straight_strings import PARAMETERS, TABLE_Z, R, straight


def table(*objects: tuple[float, float, float, float, float]) -> HeightMap:
    """A table of 0.4 by 0.2 m about the origin, with objects (x0, x1, y0, y1, height)."""
    heights = HeightMap(-0.2, -0.1, CELL_M, np.full((200, 100), TABLE_Z, dtype=np.float32))
    x, y = np.moveaxis(heights.cell_centres(), -1, 0)
    z = heights.z_m.copy()
    for x0, x1, y0, y1, height in objects:
        z[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = TABLE_Z + height
    return replace(heights, z_m=z)


@pytest.mark.parametrize(
    ("objects", "height"),
    [
        ([], 0.0),
        ([(-0.15, 0.15, -0.04, 0.04, 0.003)], 0.003),
        # Under half of the string, beside it, and lower than the noise.
        ([(-0.15, 0.0, -0.04, 0.04, 0.003)], 0.0),
        ([(-0.15, 0.15, 0.002, 0.04, 0.003)], 0.0),
        ([(-0.15, 0.15, -0.04, 0.04, 0.001)], 0.0),
    ],
)
def test_a_string_rests_on_what_lies_under_it_along_its_length(
    objects: list[tuple[float, float, float, float, float]], height: float
) -> None:
    support = SupportSurface(TABLE_Z, table(*objects))
    assert support.height_under(straight().points, R) == pytest.approx(TABLE_Z + height, abs=1e-7)


def test_a_raised_part_of_a_noisy_table_is_no_object() -> None:
    heights = table((-0.15, 0.15, -0.04, 0.04, 0.003))
    for scatter_m, height in ((0.001, 0.003), (0.002, 0.0)):
        support = SupportSurface(TABLE_Z, heights, scatter_m=scatter_m)
        assert support.height_under(straight().points, R) == pytest.approx(TABLE_Z + height, abs=1e-7)


def test_without_a_height_map_a_string_rests_on_the_table() -> None:
    assert SupportSurface(TABLE_Z).height_under(straight().points, R) == TABLE_Z
    far = straight().points + (5.0, 0.0, 0.0)
    assert SupportSurface(TABLE_Z, table()).height_under(far, R) == TABLE_Z


def test_the_surface_of_a_plate_under_a_string_is_removed() -> None:
    plate = 0.008
    support = SupportSurface(TABLE_Z, table((-0.15, 0.15, -0.09, 0.09, plate)))
    string = straight(z=plate + R)
    low = TABLE_Z + plate + PARAMETERS.z_t - 1e-6
    surface = np.array(
        [[0, 0.03, TABLE_Z + plate], [0, 0.03, low], [0, 0.03, low + 2e-6], [0, MAX_DISTANCE_M + 0.001, low]]
    )
    np.testing.assert_array_equal(support.remove_from(surface, [string], PARAMETERS), surface[2:])
    # A string on the table keeps all.
    assert SupportSurface(TABLE_Z, table()).remove_from(surface, [straight()], PARAMETERS) is surface
    assert support.remove_from(surface, [], PARAMETERS) is surface


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.0, 0.003, 0.008])
def test_a_string_on_a_plate_is_recognised_as_on_the_table(height: float) -> None:
    flat = make_scene("figure-eight", 5)
    raised = [curve + (0.0, 0.0, height) for curve in flat.curves]
    boxes = (Box((0.0, 0.0), (0.34, 0.30, height), 0.0),) if height else ()
    scan = simulate(replace(flat, curves=tuple(raised), boxes=boxes), camera_model("ideal"), 5)
    model = recognise(scan.views, RecognitionRequest(radius_m=flat.radius_m), Scene(0.0, scan.header.workspace_m)).model
    result = score(model.to_json(), scan.truth)
    assert model.quality.verdict == "accept"
    assert result.topology
    assert result.mean_m is not None
    # The median of the tier `paper` is 0.16 mm. Without the lower plane, a plate of 3 mm moves the table by 1.5 mm.
    assert result.mean_m < 0.0004
    assert len(model.grasps) > 20
    for grasp in model.grasps:
        tip = grasp.T_base_grasp[2, 3] + grasp.T_base_grasp[2, 2] * grasp.reach_m
        assert tip > height + 0.0005
