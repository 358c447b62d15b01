"""The judge of grasps by exact geometry: hand-made cases with known distances."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
from cell.simulation.evaluation.grasp_clearance import FAR_M, GraspClearance, grasp_clearances, oriented_box_distance
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.grasping.gripper import Gripper, swept_distance
from recognition.model.grasps import ScoredGrasp

R = 0.004
GRIPPER = Gripper(finger_width_m=0.010, finger_thickness_m=0.005, finger_depth_m=0.040, stroke_m=0.085)
ROUNDING_M = 1e-9
"""Distances from boxes and from the table are exact."""
STRING_M = 2e-5
"""Distances from the side of a string are up to this too large, because it counts as spheres every 0.25 mm."""
END_M = 1.8e-4
"""Distances from an end of a string are up to this too large, because it counts as surface points 0.25 mm apart."""


def line(*, x: float = 0.0, z: float = R, first: float = -0.1, last: float = 0.1) -> NDArray[np.float64]:
    """Return a straight centre line along y."""
    y = np.arange(first, last + 1e-9, 0.001)
    return np.column_stack([np.full_like(y, x), y, np.full_like(y, z)])


def scene(*boxes: Box, others: tuple[NDArray[np.float64], ...] = ()) -> StringScene:
    return StringScene("hand-made", R, (line(), *others), boxes)


def grasp(tilt_rad: float = 0.0, z: float = R, opening_m: float = 0.014, reach_m: float = 0.003) -> ScoredGrasp:
    """Return a grasp at the origin of the string: x across it, y along it, z down, tilted about y."""
    T = np.eye(4)
    T[:3, :3] = from_rotation_vector((0.0, 0.0, 0.0), (0.0, tilt_rad, 0.0))[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    T[2, 3] = z
    return ScoredGrasp(0, 0.1, T, opening_m, reach_m, 0.03, z - reach_m, 1.0)


def judge(hand_made: StringScene, requested: ScoredGrasp, error: NDArray[np.float64] | None = None) -> GraspClearance:
    (found,) = grasp_clearances([requested], hand_made, GRIPPER, error)
    return found


def test_a_string_alone_on_the_table() -> None:
    found = judge(scene(), grasp())
    assert found.fingers.table_m == pytest.approx(0.001, abs=ROUNDING_M), "r minus the reach"
    assert found.palm.table_m == pytest.approx(0.001 + 0.040, abs=ROUNDING_M)
    assert found.fingers.gripped_m == pytest.approx(0.007 - R, abs=STRING_M), "half the opening less r"
    assert found.palm.gripped_m == pytest.approx(0.040 - 0.003 - R, abs=STRING_M)
    assert found.hold_m == pytest.approx(0.003, abs=ROUNDING_M)
    assert (found.fingers.box_m, found.fingers.string_m) == (FAR_M, FAR_M)
    assert (found.string, found.touches) == (0, False)
    assert found.off_m == pytest.approx(0.0, abs=ROUNDING_M)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("height_m", "gap_m"), [(0.0005, None), (0.0008, None), (0.002, 0.0), (0.02, 0.0)])
def test_a_bar_under_a_fingertip_is_touched_if_it_is_higher_than_the_tip(
    side: int, height_m: float, gap_m: float | None
) -> None:
    # The outer faces of the fingers are at 12 mm. The bar begins at 8 mm.
    found = judge(scene(Box((side * 0.013, 0.0), (0.010, 0.08, height_m), 0.0)), grasp())
    assert found.fingers.box_m == pytest.approx(0.001 - height_m if gap_m is None else gap_m, abs=ROUNDING_M)
    assert found.touches == (height_m >= 0.001)
    assert ("box" in found.fingers.contact) == found.touches
    assert found.between.box_m > 0, "the fingers close away from the bar"


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, np.pi / 2])
def test_a_wall_beside_the_fingers_has_its_true_distance(angle_rad: float) -> None:
    turned = Box((0.05, 0.0), (0.004, 0.004, 0.03), angle_rad)
    found = judge(scene(turned), grasp())
    nearest = 0.05 - 0.002 * (abs(np.cos(angle_rad)) + abs(np.sin(angle_rad)))
    assert found.fingers.box_m == pytest.approx(nearest - 0.012, abs=ROUNDING_M)
    # The palm is 95 mm wide across the string, and 41 mm above the table at its lowest.
    inward = max(nearest - 0.0475, 0.0)
    assert found.palm.box_m == pytest.approx(np.hypot(inward, 0.041 - 0.03), abs=ROUNDING_M)


def test_a_high_wall_is_touched_by_the_palm_and_on_the_approach() -> None:
    found = judge(scene(Box((0.03, 0.0), (0.004, 0.06, 0.05), 0.0)), grasp())
    assert found.palm.contact == ("box",)
    assert found.fingers.contact == ()
    assert found.touches
    # A tilted gripper passes over the wall on its approach, although its fingers end beside it.
    above = judge(scene(Box((0.045, 0.0), (0.004, 0.06, 0.05), 0.0)), grasp(tilt_rad=0.7, reach_m=0.0))
    below = judge(scene(Box((-0.045, 0.0), (0.004, 0.06, 0.05), 0.0)), grasp(tilt_rad=0.7, reach_m=0.0))
    assert sorted(["box" in above.fingers.contact, "box" in below.fingers.contact]) == [False, True]


@pytest.mark.parametrize("tilt_deg", [-30, -10, 10, 30])
def test_the_outer_corner_of_a_tilted_finger_is_the_lowest_point(tilt_deg: float) -> None:
    tilt = np.deg2rad(tilt_deg)
    found = judge(scene(), grasp(tilt_rad=tilt, reach_m=0.001))
    assert found.fingers.table_m == pytest.approx(R - np.cos(tilt) * 0.001 - abs(np.sin(tilt)) * 0.012, abs=ROUNDING_M)


def test_a_plate_under_the_string_counts_as_a_box() -> None:
    on_plate = StringScene("hand-made", R, (line(z=R + 0.005),), (Box((0.0, 0.0), (0.1, 0.1, 0.005), 0.3),))
    found = judge(on_plate, grasp(z=R + 0.005))
    assert found.fingers.table_m == pytest.approx(0.006, abs=ROUNDING_M)
    assert found.fingers.box_m == pytest.approx(0.001, abs=ROUNDING_M)
    too_deep = judge(on_plate, grasp(z=R + 0.005, reach_m=0.0045))
    assert too_deep.fingers.contact == too_deep.between.contact == ("box",)


def test_another_string_has_the_distance_of_its_surface() -> None:
    found = judge(scene(others=(line(x=0.02),)), grasp())
    # The tip is lower than the axis of the other string, so the nearest points are at its height.
    assert found.fingers.string_m == pytest.approx(0.02 - 0.012 - R, abs=STRING_M)
    assert not found.touches
    near = judge(scene(others=(line(x=0.012),)), grasp())
    assert near.fingers.contact == ("string",)
    assert near.fingers.string_m == pytest.approx(-R, abs=STRING_M), "its centre line is at the outer face"
    assert near.touches


def test_the_end_of_another_string_is_square() -> None:
    # It ends 6 mm from the middle of the fingers, of which each is 10 mm wide.
    ahead = judge(scene(others=(line(x=0.0095, first=0.006, last=0.1),)), grasp())
    assert ahead.fingers.string_m == pytest.approx(0.001, abs=END_M)
    assert not ahead.touches


def test_a_strand_over_the_gripped_one_counts_as_another() -> None:
    across = line(z=3 * R)[:, [1, 0, 2]]
    found = judge(scene(others=(across,)), grasp())
    assert "string" in found.fingers.contact
    assert found.between.contact == ("string",)
    # A part of the gripped string itself that comes back, too.
    y = np.linspace(0, np.pi, 200)
    turn = np.column_stack([0.009 - 0.009 * np.cos(y), 0.1 + 0.009 * np.sin(y), np.full(200, R)])
    hairpin = np.vstack([line(), turn[1:-1], line(x=0.018)[::-1]])
    assert "string" in judge(StringScene("hairpin", R, (hairpin,)), grasp(opening_m=0.022)).fingers.contact


def test_an_error_of_the_robot_moves_the_gripper_in_the_frame_of_the_grasp() -> None:
    deeper = np.eye(4)
    deeper[:3, 3] = 0.002, 0.0, 0.0015
    found = judge(scene(), grasp(), deeper)
    assert found.fingers.table_m == pytest.approx(-0.0005, abs=ROUNDING_M)
    assert found.fingers.contact == ("table",)
    assert found.touches
    assert found.fingers.gripped_m == pytest.approx(0.001, abs=STRING_M), "2 mm nearer on one side"
    assert found.hold_m == pytest.approx(0.0045, abs=ROUNDING_M)
    assert found.off_m == pytest.approx(0.0, abs=ROUNDING_M), "of the requested grasp"


def test_a_grasp_above_the_string_does_not_hold_it() -> None:
    assert judge(scene(), grasp(z=0.02)).hold_m == pytest.approx(R - 0.02 + 0.003, abs=ROUNDING_M)
    nowhere = replace(scene(), curves=(), radii_m=())
    assert judge(nowhere, grasp()).hold_m == -np.inf


def alternating_projections(first: tuple[NDArray, NDArray], second: tuple[NDArray, NDArray]) -> float:
    """Return the distance of two boxes of half sizes (3,) and frames (4, 4), independently of the code under test."""
    point = previous = np.zeros(3)
    for _ in range(1500):
        for T, half in (first, second):
            previous = point
            local = np.clip((point - T[:3, 3]) @ T[:3, :3], -half, half)
            point = T[:3, :3] @ local + T[:3, 3]
    return float(np.linalg.norm(point - previous))


def test_the_distance_of_boxes_is_exact() -> None:
    rng = np.random.default_rng(1)
    apart = []
    for _ in range(25):
        (first, half), (second, other_half) = (
            (from_rotation_vector(rng.uniform(-0.06, 0.06, 3), rng.uniform(-2, 2, 3)), rng.uniform(0.002, 0.03, 3))
            for _ in range(2)
        )
        found = oriented_box_distance(first, -half, half, second, -other_half, other_half)
        assert found == pytest.approx(alternating_projections((first, half), (second, other_half)), abs=1e-6)
        apart.append(found)
    assert sum(distance > 0 for distance in apart) > 12
    assert sum(distance == 0 for distance in apart) > 2


def test_edges_that_cross_at_a_distance_are_nearest_at_their_middles() -> None:
    # Two long bars, each turned onto an edge, one across above the other.
    edge = 0.01 * np.sqrt(2)
    half = np.array([0.1, 0.01, 0.01])
    lower = from_rotation_vector((0.0, 0.0, 0.0), (np.pi / 4, 0.0, 0.0))
    upper = from_rotation_vector((0.0, 0.0, 2 * edge + 0.003), (0.0, 0.0, np.pi / 2)) @ lower
    assert oriented_box_distance(lower, -half, half, upper, -half, half) == pytest.approx(0.003, abs=ROUNDING_M)
    assert transform_points(lower, np.array([[0.0, 0.01, 0.01]]))[0, 2] == pytest.approx(edge)


def test_distances_agree_with_the_swept_volume_of_the_planner() -> None:
    rng = np.random.default_rng(2)
    side = np.linspace(-0.5, 0.5, 21)
    cube = np.stack(np.meshgrid(side, side, side + 0.5, indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(12):
        size = np.append(rng.uniform(0.004, 0.02, 2), rng.uniform(0.002, 0.06))
        box = Box((float(rng.uniform(-0.06, 0.06)), float(rng.uniform(-0.06, 0.06))), tuple(size), rng.uniform(0, 3))
        requested = grasp(tilt_rad=float(rng.uniform(-0.5, 0.5)))
        turned = from_rotation_vector((*box.centre_m, 0.0), (0.0, 0.0, box.yaw_rad))
        local = transform_points(inverse(requested.T_base_grasp), transform_points(turned, cube * size))
        opening, reach = (np.full(len(local), value) for value in (requested.opening_m, requested.reach_m))
        planned = swept_distance(local, opening, reach, GRIPPER, np.zeros(len(local), dtype=bool)).min()
        found = judge(scene(box), requested)
        # Points of the box are up to 1/40 of its size apart from the nearest one.
        tolerance_m = float(np.linalg.norm(size)) / 40
        assert min(found.fingers.box_m, found.palm.box_m, 0.03) == pytest.approx(min(planned, 0.03), abs=tolerance_m)
