"""The floor for the fingertips on height maps with known objects and noise, and grasps beside low objects."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.grasping.grasp_planner import MIN_REACH_SHARE
from recognition.grasping.local_floor import (
    MIN_HEIGHT_M,
    MIN_HEIGHT_SIGMAS,
    LocalFloor,
    find_local_floor,
    low_object_findings,
)
from recognition.preprocessing.height_map import CELL_M, HeightMap
from recognition.preprocessing.support_surface import EDGE_M, SupportSurface
from tests.recognition.straight_strings import GRIPPER, TABLE_Z, R, finger_points, grasps_of, straight

SHAPE = (200, 100)
SIGMA = 0.00015


def table(*objects: tuple[float, float, float, float, float], sigma: float = 0.0, seed: int = 0) -> HeightMap:
    """A table of 0.4 by 0.2 m about the origin, with objects (x0, x1, y0, y1, height), and noise."""
    heights = HeightMap(-0.2, -0.1, CELL_M, np.zeros(SHAPE, dtype=np.float32))
    z = np.random.default_rng(seed).normal(TABLE_Z, sigma, SHAPE)
    x, y = np.moveaxis(heights.cell_centres(), -1, 0)
    for x0, x1, y0, y1, height in objects:
        z[(x > x0) & (x < x1) & (y > y0) & (y < y1)] += height
    return replace(heights, z_m=z.astype(np.float32))


def floor_of(heights: HeightMap) -> LocalFloor:
    return find_local_floor(SupportSurface(TABLE_Z, heights), [straight()])


@pytest.mark.parametrize("height", [0.0015, 0.004, 0.03])
def test_an_object_above_the_noise_is_floor(height: float) -> None:
    heights = table((-0.05, 0.05, 0.02, 0.026, height), sigma=SIGMA)
    floor = floor_of(heights)
    x, y = np.moveaxis(heights.cell_centres(), -1, 0)
    is_object = (np.abs(x) < 0.05) & (y > 0.02) & (y < 0.026)
    np.testing.assert_array_equal(floor.is_raised, is_object)
    assert floor.min_height_m == MIN_HEIGHT_M
    assert floor.highest(np.array([[[0.0, 0.023], [0.0, 0.04]]])) == pytest.approx(TABLE_Z + height, abs=4 * SIGMA)
    assert floor.highest(np.array([[[0.0, 0.05], [0.0, 0.04]]])) == pytest.approx(TABLE_Z, abs=SIGMA)
    # Every cell of the bar is at its edge, as it is three cells wide with the table on both sides.
    edges = floor.edge_points()
    assert len(edges) >= 2 * 50
    assert edges[:, 2].min() > TABLE_Z + height - 6 * SIGMA


def test_the_string_is_not_floor() -> None:
    heights = table((-0.1, 0.1, -R, R, 2 * R))
    floor = floor_of(heights)
    assert not floor.is_raised.any()
    near = np.array([[0.0, R + EDGE_M - CELL_M]])
    assert floor.highest(near[:, None]) == TABLE_Z


def test_the_limit_grows_with_the_noise_and_is_a_note() -> None:
    sigma = 0.0004
    floor = floor_of(table((-0.05, 0.05, 0.02, 0.03, 0.0015), sigma=sigma))
    # The deviation of 15,000 cells, of which those beyond 1.2 mm do not count, is known to some per cent.
    assert floor.min_height_m == pytest.approx(MIN_HEIGHT_SIGMAS * sigma, rel=0.05)
    assert not floor.is_raised.any()
    (note,) = low_object_findings(floor)
    assert (note.code, note.severity, note.limit) == ("low-objects-hidden", "note", MIN_HEIGHT_M)
    assert note.value == floor.min_height_m
    assert "lower than 2.0 mm" in note.message
    assert low_object_findings(floor_of(table(sigma=SIGMA))) == []


def test_a_slow_error_of_the_camera_is_no_object() -> None:
    heights = table(sigma=SIGMA)
    x = heights.cell_centres()[..., 0]
    bent = replace(heights, z_m=(heights.z_m + 0.001 * (x / 0.2) ** 2).astype(np.float32))
    assert not floor_of(bent).is_raised.any()


def test_a_place_that_no_view_measured_is_not_free() -> None:
    heights = table()
    z = heights.z_m.copy()
    z[100, 80] = np.nan  # one cell, which its neighbours tell
    z[40:60, 60:90] = np.nan
    floor = floor_of(replace(heights, z_m=z))
    assert floor.highest(np.array([[[0.001, 0.061]]])) == TABLE_Z
    assert floor.highest(np.array([[[-0.1, 0.05]]])) == np.inf
    assert floor.highest(np.array([[[0.5, 0.0]]])) == np.inf


def test_fingertips_stay_above_a_plate_under_the_string() -> None:
    plate = 0.002
    string = straight(z=plate + R)
    floor = find_local_floor(SupportSurface(TABLE_Z, table((-0.15, 0.15, -0.04, 0.04, plate))), [string])
    grasps, _ = grasps_of(string, floor=floor)
    assert len(grasps) > 30
    for grasp in grasps:
        assert grasp.table_clearance_m == pytest.approx(GRIPPER.table_clearance_m, abs=1e-6)
        assert finger_points(grasp)[:, 2].min() == pytest.approx(TABLE_Z + plate + grasp.table_clearance_m, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0015, 0.01), st.floats(0.002, 0.012), st.floats(0.004, 0.02), st.sampled_from((-1, 1)))
def test_no_fingertip_comes_down_on_a_bar(height: float, gap: float, width: float, side: int) -> None:
    low, high = sorted((side * (R + gap), side * (R + gap + width)))
    grasps, _ = grasps_of(straight(), floor=floor_of(table((-0.15, 0.15, low, high, height))))
    for grasp in grasps:
        fingers = finger_points(grasp)
        # The bar in the map is as wide as its cells, and so up to half a cell smaller than the true bar.
        over_bar = (fingers[:, 1] > low + CELL_M / 2) & (fingers[:, 1] < high - CELL_M / 2)
        assert (fingers[over_bar, 2] > TABLE_Z + height + GRIPPER.min_table_clearance_m - 1e-6).all()
        assert grasp.reach_m >= MIN_REACH_SHARE * R - 1e-9
        if over_bar.any():
            assert fingers[:, 2].min() - TABLE_Z - height == pytest.approx(grasp.table_clearance_m, abs=1e-6)
    # Far from the bar there is always a grasp, and so there is over a low one.
    assert grasps or gap < GRIPPER.opening_margin_m / 2 + GRIPPER.finger_thickness_m + 2 * CELL_M


def test_without_a_measured_floor_there_is_no_grasp() -> None:
    grasps, notes = grasps_of(straight(), floor=find_local_floor(SupportSurface(TABLE_Z), [straight()]))
    assert grasps == ()
    assert "not measured" in notes[0].message
