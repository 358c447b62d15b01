"""Targets of the moves of a program."""

import re

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_models import ArmModelName
from cell.simulation.ur_controller.robot.arm import Goal, UnreachableGoalError
from cell.simulation.ur_controller.robot.poses import line_steps, pose_matrix, pose_vector
from cell.simulation.ur_controller.robot.tcp import Tool
from cell.simulation.ur_controller.robot.trajectories import JointMove, Joints, LineMove, Motion

_NUMBER = r"[-+0-9.eE]+"
_PATH_MOVE = re.compile(
    rf"^\s*move([jlp])\((p?)\[({_NUMBER}(?:,\s*{_NUMBER}){{5}})\],\s*a=({_NUMBER}),\s*v=({_NUMBER}),\s*r=", re.MULTILINE
)


def joint_goal(q_to: Joints, speed_rad_s: float, acceleration_rad_s2: float) -> Goal:
    """Return the target of a movej."""

    def plan(q: Joints) -> Motion:
        return JointMove(q, q_to, speed_rad_s, acceleration_rad_s2)

    details = {"q_to_rad": q_to.tolist(), "speed": speed_rad_s, "acceleration": acceleration_rad_s2}
    return Goal("movej", plan, details)


def line_goal(
    model: ArmModelName, tool: Tool, T_base_tcp: NDArray[np.float64], speed_m_s: float, acceleration_m_s2: float
) -> Goal:
    """Return the target of a movel."""

    def plan(q: Joints) -> Motion:
        steps, length_m = line_steps(model, q, T_base_tcp, tool.T_flange_tcp)
        if steps is None:
            raise UnreachableGoalError("movel: the straight line passes out of reach or a singularity")
        return LineMove(steps, length_m, speed_m_s, acceleration_m_s2)

    details = {"pose_to": pose_vector(T_base_tcp), "speed": speed_m_s, "acceleration": acceleration_m_s2}
    return Goal("movel", plan, details)


def path_goals(model: ArmModelName, tool: Tool, text: str) -> list[Goal]:
    """Return the moves of the path that ur_rtde wrote into its program.

    Blends are ignored, so the arm stops at each point.
    """
    goals = []
    for kind, pose, numbers, acceleration, speed in _PATH_MOVE.findall(text):
        target, v, a = [float(number) for number in numbers.split(",")], float(speed), float(acceleration)
        if kind == "j" and not pose:
            goals.append(joint_goal(np.array(target), v, a))
        else:
            T_base_tcp = pose_matrix(target) if pose else tool.at(np.array(target))
            goals.append(line_goal(model, tool, T_base_tcp, v, a))
    return goals
