import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_rotation_vector
from cell.config.arm_models import ArmModelName
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.poses import line_steps, nearest_solution, pose_matrix, pose_vector, twist

angle = st.floats(-np.pi, np.pi)
Q = np.array([0.4, -1.3, 1.5, -1.7, -1.5, 0.3])


@given(st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_a_pose_vector_gives_the_same_pose(pose: list[float]):
    T = pose_matrix(pose)
    # Near half a turn, the square root of the sine loses half the digits.
    np.testing.assert_allclose(pose_matrix(pose_vector(T)), T, atol=1e-7)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, -1, 0), (0.2, -0.3, 0.9), (-1, -2, -3)])
@pytest.mark.parametrize("turn", [np.pi, np.pi - 1e-9, 1e-9, 0.0])
def test_half_turns_and_the_identity_are_exact(axis: tuple[float, float, float], turn: float):
    R = Rotation.from_rotvec(turn * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    T = np.eye(4)
    T[:3, :3] = R
    np.testing.assert_allclose(pose_matrix(pose_vector(T))[:3, :3], R, atol=1e-7)


def test_the_twist_is_the_jacobian_times_the_joint_speeds():
    qd, dt = np.array([0.3, -0.2, 0.5, 0.1, -0.4, 0.7]), 1e-5
    T = [ur_kinematics.forward("ur5e", q) for q in (Q, Q + dt * qd)]
    # The error of the first-order difference is the acceleration times dt / 2.
    np.testing.assert_allclose(twist(T[0], T[1], dt), ur_kinematics.jacobian("ur5e", Q) @ qd, atol=1e-4)


@pytest.mark.parametrize("model", ["ur3e", "ur5e", "ur10e"])
def test_the_nearest_solution_is_the_present_configuration(model: ArmModelName):
    turned = Q + np.array([0.0, 0.0, 0.0, 2 * np.pi, 0.0, -2 * np.pi])
    for q_near in (Q, turned):
        q = nearest_solution(model, ur_kinematics.forward(model, Q), q_near + 0.05)
        assert q is not None
        np.testing.assert_allclose(q, q_near, atol=1e-7)


def test_an_unreachable_pose_has_no_solution():
    assert nearest_solution("ur5e", from_rotation_vector((3.0, 0.0, 0.5), np.zeros(3)), Q) is None


def test_a_tool_line_is_straight_between_its_steps():
    T_flange_tool = from_rotation_vector((0.0, 0.02, 0.1), (0.1, 0.0, 0.0))
    T_from = ur_kinematics.forward("ur5e", Q) @ T_flange_tool
    T_to = T_from @ from_rotation_vector((0.1, -0.05, 0.02), (0.0, 0.2, 0.1))
    steps, length_m = line_steps("ur5e", Q, T_to, T_flange_tool)
    assert steps is not None
    assert length_m == pytest.approx(np.linalg.norm(T_to[:3, 3] - T_from[:3, 3]))
    way = (T_to[:3, 3] - T_from[:3, 3]) / length_m
    between = [*steps, *(0.5 * (steps[1:] + steps[:-1]))]
    points = np.array([(ur_kinematics.forward("ur5e", q) @ T_flange_tool)[:3, 3] for q in between]) - T_from[:3, 3]
    off = points - np.outer(points @ way, way)
    # Lines in joint space over 2 cm deviate by some hundredths of a millimetre.
    assert np.linalg.norm(off, axis=1).max() < 2e-4
    np.testing.assert_allclose(ur_kinematics.forward("ur5e", steps[-1]) @ T_flange_tool, T_to, atol=1e-6)


def test_an_unreachable_line_is_none():
    T_to = from_rotation_vector((2.0, 0.0, 0.5), (np.pi, 0.0, 0.0))
    assert line_steps("ur5e", Q, T_to, np.eye(4))[0] is None
