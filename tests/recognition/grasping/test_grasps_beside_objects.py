"""Other objects on the table remove grasps or tilt them, for strings of any radius."""

import numpy as np
import pytest

from recognition.geometry.voxel_grid import voxel_means
from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M
from recognition.grasping.gripper import Gripper, swept_distance
from recognition.grasping.obstacles import VOXEL_M, gather_obstacles
from recognition.parameters import ChainParameters
from recognition.registration.fusion import MAX_POINTS, VOXEL_RADII
from tests.recognition.straight_strings import GRIPPER, HALF_FINGER, TABLE_Z, R, finger_points, grasps_of, straight

pytestmark = pytest.mark.slow

RADII = (0.001, 0.0042, 0.012, 0.02)
RAISED = 0.01
"""Height of the string's underside above the table: the fingers reach around the thinnest string too."""


def box(x: float, y: float, size: float = 0.03, height: float = 0.03) -> np.ndarray:
    """Points of a box's top and the side towards the string, every millimetre."""
    a = np.arange(0, size + 1e-9, 0.001)
    u, v = (grid.ravel() for grid in np.meshgrid(a, a))
    top = np.column_stack([x + u, y + v, np.full(len(u), height)])
    side = np.column_stack([x + u, np.full(len(u), y), v * height / size])
    return np.vstack([top, side]) + np.array([0, 0, TABLE_Z])


def test_a_box_beside_the_string_removes_grasps() -> None:
    free, _ = grasps_of(straight())
    # 9 mm from the centre line: a finger of 5 mm does not fit between. It stands from 100 to 130 mm.
    grasps, _ = grasps_of(straight(), surface=box(0.0, 0.009))
    assert len(grasps) < len(free)
    s = np.array([grasp.s_m for grasp in grasps])
    assert not ((s > 0.1 - HALF_FINGER) & (s < 0.13 + HALF_FINGER)).any()
    assert (s < 0.1 - HALF_FINGER - 0.005).any()
    assert (s > 0.13 + HALF_FINGER + 0.005).any()
    # Farther away it only reduces the clearance: 25 mm minus the outer face of a finger and up to 2.1 mm for the balls.
    grasps, _ = grasps_of(straight(), surface=box(0.0, 0.025, height=0.02))
    assert len(grasps) == len(free)
    nearest = min(grasp.clearance_m for grasp in grasps if grasp.T_base_grasp[2, 2] < -0.999)
    assert 0.025 - 0.0112 - 0.0021 < nearest <= 0.025 - 0.0112


def test_high_objects_block_the_palm() -> None:
    # 30 mm beside, where only the palm passes, 36.8 mm above the string's centre line.
    low, _ = grasps_of(straight(), surface=box(-0.1, 0.03, height=0.02))
    high, notes = grasps_of(straight(length=0.06), surface=box(-0.015, 0.03, height=0.06))
    assert low
    assert high == ()
    assert "would touch" in notes[0].message


def test_a_strand_is_grasped_with_a_tilt_if_straight_down_is_blocked() -> None:
    # Centre line at 20 mm, fingertips at 15.8; on the left, from 8.5 mm on, everything is 17 mm high.
    raised = straight(z=0.02)
    shelf = box(-0.11, 0.0085, size=0.22, height=0.017)
    grasps, _ = grasps_of(raised, surface=shelf)
    assert len(grasps) == len(grasps_of(raised)[0])
    for grasp in grasps:
        # Only leaning by 30 degrees, with the left finger up: its tip is then at 19.5 mm.
        np.testing.assert_allclose(grasp.T_base_grasp[2, :3], (0.5, 0, -np.sqrt(0.75)), rtol=0, atol=1e-9)
        # Less up to 2.1 mm for the balls of voxels.
        assert GRIPPER.clearance_m <= grasp.clearance_m < 0.0025
        fingers = finger_points(grasp)
        assert fingers[fingers[:, 1] > 0.0085][:, 2].min() > TABLE_Z + 0.019
    others, _ = grasps_of(raised, surface=shelf * np.array([1, -1, 1]))
    assert {round(grasp.T_base_grasp[2, 0], 9) for grasp in others} == {-0.5}


def wall(y: float, height: float, r: float, length: float = 0.24) -> np.ndarray:
    """Merged points of an upright wall along x at that y, and of a plate far away: as many as are taken."""
    spacing = VOXEL_RADII * r
    fine = max(spacing / 4, 0.0005)
    u, v = np.meshgrid(np.arange(-length / 2, length / 2, fine), np.arange(0, height + 1e-9, fine))
    points, _ = voxel_means(np.column_stack([u.ravel(), np.full(u.size, y), TABLE_Z + v.ravel()]), spacing)
    rest = np.arange(MAX_POINTS - len(points))
    plate = np.column_stack([1 + spacing * (rest // 400), spacing * (rest % 400), np.full(len(rest), TABLE_Z + 0.05)])
    return np.vstack([points, plate])


@pytest.mark.parametrize("r", RADII)
def test_no_finger_goes_through_a_wall(r: float) -> None:
    parameters, string = ChainParameters.for_radius(r), straight(z=r + RAISED, r=r)
    assert grasps_of(string, parameters=parameters)[0]
    # A finger takes from 2 to 7 mm beside the string.
    grasps, notes = grasps_of(string, surface=wall(r + 0.005, 0.08, r), parameters=parameters)
    assert grasps == ()
    assert "would touch" in notes[0].message


@pytest.mark.parametrize("beside", [0.006, 0.008, 0.012, 0.024])
@pytest.mark.parametrize("r", RADII)
def test_clearance_from_a_wall_is_never_more_than_there_is(r: float, beside: float) -> None:
    parameters, string = ChainParameters.for_radius(r), straight(z=r + RAISED, r=r)
    y = r + beside
    gripper = Gripper(finger_depth_m=0.12)
    grasps, _ = grasps_of(string, surface=wall(y, 0.08, r), gripper=gripper, parameters=parameters)
    assert grasps or beside < 0.024
    # Balls reach beyond the wall by their radius, and lie up to half a voxel before it.
    blur = np.sqrt(3) / 2 * max(VOXEL_M, VOXEL_RADII * r) + VOXEL_M / 2
    for grasp in grasps:
        true = y - finger_points(grasp)[:, 1].max()
        assert max(GRIPPER.clearance_m, min(true, MAX_RELEVANT_DISTANCE_M) - blur) <= grasp.clearance_m <= true + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_of_many_objects_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heap = rng.uniform((-0.1, -0.1, TABLE_Z), (0.1, 0.1, TABLE_Z + 0.03), (3000, 3))
    heap = heap[np.abs(heap[:, 1]) > 0.014 + 0.01 * np.sin(40 * heap[:, 0])]
    string = straight(z=0.02)
    grasps, _ = grasps_of(string, surface=heap)
    assert len({round(grasp.clearance_m, 6) for grasp in grasps}) > 5
    objects = gather_obstacles((string,), heap, VOXEL_RADII * R).objects
    n = len(objects.points)
    for grasp in grasps:
        local = (objects.points - grasp.T_base_grasp[:3, 3]) @ grasp.T_base_grasp[:3, :3]
        opening, reach = np.full(n, grasp.opening_m), np.full(n, grasp.reach_m)
        distance = swept_distance(local, opening, reach, GRIPPER, np.ones(n, dtype=bool)) - objects.radius_m
        assert grasp.clearance_m == pytest.approx(min(distance.min(), MAX_RELEVANT_DISTANCE_M), abs=1e-12)


@pytest.mark.parametrize("r", RADII)
def test_flying_points_remove_no_grasp(r: float) -> None:
    parameters, string = ChainParameters.for_radius(r), straight(z=r + RAISED, r=r)
    flying = np.random.default_rng(2).uniform((-0.1, -0.1, TABLE_Z + 0.03), (0.1, 0.1, TABLE_Z + 0.3), (30, 3))
    free, _ = grasps_of(string, parameters=parameters)
    assert len(grasps_of(string, surface=flying, parameters=parameters)[0]) == len(free)


def test_objects_alone_have_no_grasp() -> None:
    assert grasps_of(surface=box(0, 0)) == ((), ())
