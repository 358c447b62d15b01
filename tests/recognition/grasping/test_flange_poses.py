"""Flange poses of grasps, by hand."""

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from recognition.grasping.flange_poses import LIFT_M, T_flange_tcp, approach_distance_m, flange_poses
from recognition.grasping.gripper import Gripper

GRIPPER = Gripper(length_m=0.15, finger_depth_m=0.04)
DOWN = np.array([[0.0, 1, 0, 0.4], [1, 0, 0, 0.1], [0, 0, -1, 0.005], [0, 0, 0, 1]])
"""A grasp from straight above that closes along y of the base."""


def test_an_upright_grasp_has_the_flange_above_it() -> None:
    poses = flange_poses(DOWN[None], [0.003], GRIPPER)
    # the fingertips are at 0.005 - 0.003, and the flange 0.15 above them
    np.testing.assert_allclose(poses.grasp[0, :3, 3], (0.4, 0.1, 0.152), rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.pregrasp[0, :3, 3], (0.4, 0.1, 0.212), rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.retreat[0, :3, 3], (0.4, 0.1, 0.212), rtol=0, atol=1e-12)
    for T in (poses.grasp, poses.pregrasp, poses.retreat):
        np.testing.assert_allclose(T[0, :3, :3], DOWN[:3, :3], rtol=0, atol=1e-12)


def test_the_tool_centre_point_is_between_the_fingertips() -> None:
    """The centre line is `reach_m` behind the tool centre point, for any tilt and mounting."""
    gripper = Gripper(length_m=0.15, mounting_rotation_rad=0.7)
    T_base_grasp = DOWN @ from_rotation_vector((0.0, 0.0, 0.0), (0.0, 0.4, 0.0))
    poses = flange_poses(T_base_grasp[None], [0.003], gripper, approach_m=0.06, lift_m=0.05)
    T_base_tcp = poses.grasp[0] @ T_flange_tcp(gripper)
    np.testing.assert_allclose(T_base_tcp[:3, :3], T_base_grasp[:3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(T_base_tcp[:3, 3] - 0.003 * T_base_grasp[:3, 2], T_base_grasp[:3, 3], rtol=0, atol=1e-12)
    back = poses.pregrasp[0, :3, 3] - poses.grasp[0, :3, 3]
    np.testing.assert_allclose(back, -0.06 * T_base_grasp[:3, 2], rtol=0, atol=1e-12)
    lift = poses.retreat[0, :3, 3] - poses.grasp[0, :3, 3]
    np.testing.assert_allclose(lift, -0.05 * T_base_grasp[:3, 2], rtol=0, atol=1e-12)


def test_the_mounting_turns_the_closing_direction() -> None:
    quarter = Gripper(mounting_rotation_rad=np.pi / 2)
    np.testing.assert_allclose(T_flange_tcp(quarter)[:3, 0], (0, 1, 0), rtol=0, atol=1e-12)
    (T,) = flange_poses(DOWN[None], [0.003], quarter).grasp
    # the closing direction of the grasp is y of the flange
    np.testing.assert_allclose(T[:3, 1], DOWN[:3, 0], rtol=0, atol=1e-12)


def test_the_turned_grasp_swaps_the_fingers() -> None:
    gripper = Gripper(mounting_rotation_rad=0.3)
    poses = flange_poses(DOWN[None], [0.003], gripper)
    one, other = (T[0] @ T_flange_tcp(gripper) for T in (poses.grasp, poses.turned().grasp))
    np.testing.assert_allclose(other[:3], one[:3] * (-1, -1, 1, 1), rtol=0, atol=1e-12)


def test_the_pregrasp_is_above_all_that_fits_under_the_palm() -> None:
    # a string beside the grasp may be as high as the palm, one finger depth above the fingertips
    assert approach_distance_m(Gripper(length_m=0.15, finger_depth_m=0.07)) == pytest.approx(0.08)
    # short fingers go back at least as far as the lift
    assert approach_distance_m(GRIPPER) == pytest.approx(LIFT_M)
