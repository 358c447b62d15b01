from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.grasp_physics.clearance import approach_clearance
from cell.simulation.grasp_physics.settings import NO_ERROR, RobotError, robot_errors
from cell.simulation.scenes.clutter import Box, Clump
from recognition.grasping.gripper import Gripper
from tests.cell.simulation.grasp_physics.scenes_and_grasps import RADIUS_M, REACH_M, straight_scene, upright_grasp

GRIPPER = Gripper()
OUTER_M = 0.0124 / 2 + GRIPPER.finger_thickness_m
"""Distance of the outer face of an open finger from the grasp."""
EXACT_M = 1e-5
"""Tolerance for distances from strings, which are sampled every 0.5 mm."""


def test_a_free_grasp_has_the_distances_of_its_geometry() -> None:
    clearance = approach_clearance(straight_scene(), upright_grasp(), GRIPPER)
    assert clearance.clean
    assert clearance.table_m == pytest.approx(RADIUS_M - REACH_M, abs=1e-9)
    assert clearance.gripped_strand_m == pytest.approx(0.0124 / 2 - RADIUS_M, abs=EXACT_M)
    assert clearance.object_m == clearance.other_strand_m == np.inf


def test_distance_from_another_string() -> None:
    clearance = approach_clearance(straight_scene(0.02), upright_grasp(), GRIPPER)
    assert clearance.other_strand_m == pytest.approx(0.02 - OUTER_M - RADIUS_M, abs=EXACT_M)
    assert clearance.clean
    clearance = approach_clearance(straight_scene(0.013), upright_grasp(), GRIPPER)
    assert clearance.other_strand_m == pytest.approx(0.013 - OUTER_M - RADIUS_M, abs=EXACT_M)
    assert not clearance.clean


def test_another_string_between_the_fingers_is_not_clean() -> None:
    grasp = upright_grasp(y_m=RADIUS_M, opening_m=0.024)
    assert approach_clearance(straight_scene(2 * RADIUS_M), grasp, GRIPPER).other_strand_m < -0.004


@pytest.mark.parametrize("yaw_rad", [0.0, np.pi / 2, np.pi / 4])
def test_distance_from_a_box(yaw_rad: float) -> None:
    size_m = 0.01 if yaw_rad != np.pi / 4 else 0.01 / np.sqrt(2)
    # Its nearest face or edge is 5 mm from its centre.
    box = Box((0.0, 0.03), (size_m, size_m, 0.02), yaw_rad)
    clearance = approach_clearance(straight_scene(boxes=(box,)), upright_grasp(), GRIPPER)
    assert clearance.object_m == pytest.approx(0.025 - OUTER_M, abs=1e-6)
    overlapping = replace(box, centre_m=(0.0, 0.014))
    clearance = approach_clearance(straight_scene(boxes=(overlapping,)), upright_grasp(), GRIPPER)
    assert clearance.object_m == 0.0
    assert not clearance.clean


def test_distance_of_a_low_box_under_a_finger() -> None:
    box = Box((0.0, 0.009), (0.02, 0.004, 0.0015), 0.0)
    clearance = approach_clearance(straight_scene(boxes=(box,)), upright_grasp(), GRIPPER)
    assert clearance.object_m == pytest.approx(RADIUS_M - REACH_M - 0.0015, abs=1e-6)


def test_the_palm_meets_a_high_box() -> None:
    palm_m = RADIUS_M - REACH_M + GRIPPER.finger_depth_m
    box = Box((0.03, 0.03), (0.01, 0.01, palm_m - 0.003), 0.3)
    clearance = approach_clearance(straight_scene(boxes=(box,)), upright_grasp(), GRIPPER)
    assert clearance.object_m == pytest.approx(0.003, abs=1e-6)
    high = replace(box, size_m=(0.01, 0.01, palm_m + 0.001))
    assert approach_clearance(straight_scene(boxes=(high,)), upright_grasp(), GRIPPER).object_m == 0.0


def test_a_clump_is_an_object() -> None:
    scene = replace(straight_scene(), clumps=(Clump((0.0, 0.04), 0.04, 0.04, 3),))
    assert approach_clearance(scene, upright_grasp(), GRIPPER).object_m < 0.003
    scene = replace(straight_scene(), clumps=(Clump((0.0, 0.2), 0.04, 0.04, 3),))
    assert 0.08 < approach_clearance(scene, upright_grasp(), GRIPPER).object_m < 0.16


def test_robot_errors_move_the_gripper() -> None:
    scene, grasp = straight_scene(), upright_grasp()
    free = approach_clearance(scene, grasp, GRIPPER, NO_ERROR)
    down = approach_clearance(scene, grasp, GRIPPER, RobotError("down", down_m=0.001))
    assert down.table_m == pytest.approx(free.table_m - 0.001)
    across = approach_clearance(scene, grasp, GRIPPER, RobotError("+x", across_m=0.001))
    assert across.gripped_strand_m == pytest.approx(free.gripped_strand_m - 0.001, abs=EXACT_M)
    # Turned about the string, the outer corner of a fingertip comes down.
    turned = approach_clearance(scene, grasp, GRIPPER, RobotError("+ry", rotation_rad=(0.0, np.deg2rad(1.0), 0.0)))
    assert turned.table_m == pytest.approx(free.table_m - OUTER_M * np.sin(np.deg2rad(1.0)), abs=1e-5)
    assert [error.name for error in robot_errors()] == ["+x", "-x", "down", "+rx", "-rx", "+ry", "-ry", "+rz", "-rz"]
