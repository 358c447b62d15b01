"""Poses in the form of UR, x, y, z and a rotation vector, and tool paths between them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.config.arm_models import ArmModelName
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.trajectories import Joints

PATH_STEP_M = 0.02
"""Distance of the points at which a straight tool path is followed exactly. Between them, the joints move along lines.
"""
PATH_STEP_RAD = 0.1
JUMP_RAD = 1.0
"""Joint motion between two such points beyond which the line passes a singularity."""


def pose_vector(T: NDArray[np.float64]) -> list[float]:
    """Return the pose (4, 4) as x, y, z, rx, ry, rz.

    It is computed by hand because it runs at the rate of the stream, where SciPy's Rotation would take most of the
    time.
    """
    (r00, r01, r02, x), (r10, r11, r12, y), (r20, r21, r22, z) = T[:3].tolist()
    ax, ay, az = r21 - r12, r02 - r20, r10 - r01
    sine, cosine = 0.5 * math.sqrt(ax * ax + ay * ay + az * az), 0.5 * (r00 + r11 + r22 - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        k = 0.5 * angle / sine
        return [x, y, z, k * ax, k * ay, k * az]
    if cosine > 0:
        return [x, y, z, 0.5 * ax, 0.5 * ay, 0.5 * az]
    # at half a turn, the axis is in the symmetric part and its sign is free
    axis = [math.sqrt(max(0.0, 0.5 * (r + 1.0))) for r in (r00, r11, r22)]
    k = axis.index(max(axis))
    row = ((r00, r01, r02), (r10, r11, r12), (r20, r21, r22))[k]
    axis = [math.copysign(a, r if i != k else 1.0) for i, (a, r) in enumerate(zip(axis, row, strict=True))]
    return [x, y, z, *(angle * a for a in axis)]


def pose_matrix(pose: Sequence[float]) -> NDArray[np.float64]:
    """Return the pose x, y, z, rx, ry, rz as a matrix (4, 4)."""
    return from_rotation_vector(pose[:3], pose[3:6])


def twist(T_from: NDArray[np.float64], T_to: NDArray[np.float64], dt_s: float) -> list[float]:
    """Return the linear and angular velocity (6,) from one pose to a close one within a short time."""
    turn = (T_to[:3, :3] @ T_from[:3, :3].T).tolist()
    vx, vy, vz = (T_to[:3, 3] - T_from[:3, 3]).tolist()
    w = (turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1])
    return [vx / dt_s, vy / dt_s, vz / dt_s, *(0.5 * each / dt_s for each in w)]


def nearest_solution(model: ArmModelName, T_base_flange: NDArray[np.float64], q_near: Joints) -> Joints | None:
    """Return the joint angles for a flange pose nearest to `q_near`, including full turns, or None out of reach."""
    found = ur_kinematics.inverse(model, T_base_flange)
    if not len(found):
        return None
    found = found + 2 * np.pi * np.round((q_near - found) / (2 * np.pi))
    limits = ur_kinematics.joint_limits(model)
    found = np.where(found > limits, found - 2 * np.pi, np.where(found < -limits, found + 2 * np.pi, found))
    return found[np.abs(found - q_near).max(axis=1).argmin()]


def line_steps(
    model: ArmModelName, q_from: Joints, T_base_tool_to: NDArray[np.float64], T_flange_tool: NDArray[np.float64]
) -> tuple[NDArray[np.float64] | None, float]:
    """Return joint angles (N, 6) along a straight line of the tool, and its length in metres.

    The joint angles are None if the arm cannot follow the line. A rotation without translation has a small length, so
    that it takes time.

    Args:
        model: Model of the arm.
        q_from: Joint angles (6,) at the start.
        T_base_tool_to: Tool pose (4, 4) at the end.
        T_flange_tool: Tool pose (4, 4) on the flange.
    """
    T_from = ur_kinematics.forward(model, q_from) @ T_flange_tool
    _, _, _, *turn = pose_vector(inverse(T_from) @ T_base_tool_to)
    way = T_base_tool_to[:3, 3] - T_from[:3, 3]
    length, angle = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
    n = max(1, math.ceil(length / PATH_STEP_M), math.ceil(angle / PATH_STEP_RAD))
    steps, T_tool_flange = [q_from], inverse(T_flange_tool)
    for share in np.linspace(0.0, 1.0, n + 1)[1:]:
        T = T_from @ from_rotation_vector(np.zeros(3), share * np.asarray(turn))
        T[:3, 3] = T_from[:3, 3] + share * way
        q = nearest_solution(model, T @ T_tool_flange, steps[-1])
        if q is None or np.abs(q - steps[-1]).max() > JUMP_RAD:
            return None, length
        steps.append(q)
    return np.array(steps), max(length, 0.1 * angle)
