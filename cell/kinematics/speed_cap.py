"""Speed of a joint move under the speed limit of the flange.

A moveJ follows a straight line in joint space. Its speed is that of the leading joint, which turns farthest.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.config.arm_config import ArmModelName
from cell.kinematics.ur_kinematics import ARMS, jacobian, joint_speeds

_STEP_RAD = 0.05
"""Sum of all joint motions between two samples of the line."""


def capped_speed(
    model: ArmModelName,
    q_from: ArrayLike,
    q_to: ArrayLike,
    speed_rad_s: float,
    flange_speed_m_s: float,
) -> float:
    """Return the speed of the leading joint, rad/s, for a straight joint move.

    Args:
        model: Model of the arm.
        q_from: Joint angles (6,) at the start, rad.
        q_to: Joint angles (6,) at the target, rad.
        speed_rad_s: Configured speed of the leading joint. The joints' own limits hold too.
        flange_speed_m_s: Speed limit of the flange's origin, which holds on the whole line. The limit between two
            samples makes the move about 1 % slower than necessary.
    """
    turn = np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64)
    furthest = float(np.abs(turn).max())
    if furthest == 0.0:
        return float(min(speed_rad_s, joint_speeds(model).min()))
    by_joints = float((joint_speeds(model) / (np.abs(turn) / furthest).clip(min=1e-12)).min())
    by_flange = flange_speed_m_s * furthest / max_flange_travel(model, q_from, q_to)
    return min(speed_rad_s, by_joints, by_flange)


def max_flange_travel(model: ArmModelName, q_from: ArrayLike, q_to: ArrayLike) -> float:
    """Return an upper bound of the flange's speed for a move of unit duration along the straight joint line, metres.

    The bound is close to the true maximum.
    """
    start = np.asarray(q_from, dtype=np.float64)
    turn = np.asarray(q_to, dtype=np.float64) - start
    total = float(np.abs(turn).sum())
    steps = int(np.ceil(total / _STEP_RAD)) + 1
    q_rad: NDArray[np.float64] = start + np.linspace(0.0, 1.0, steps + 1)[:, None] * turn
    speed = np.linalg.norm(jacobian(model, q_rad)[:, :3] @ turn, axis=1)
    # Between two samples a velocity is within h^2 / 8 max |v''| of the chord. Each derivative along the line adds at
    # most a factor of the sum of the joint motions, with a lever no longer than the stretched arm.
    arm = ARMS[model]
    lever = float(np.abs(arm.a_m).sum() + np.abs(arm.d_m).sum())
    return float(speed.max()) + lever * total**3 / (8 * steps**2)
