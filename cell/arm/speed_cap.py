"""How fast a joint move may go so that the flange keeps its speed limit.

A moveJ goes along a straight line in joint space; its speed is that of the joint that turns furthest, the leading one.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.config.arm_config import ArmModelName
from cell.kinematics.ur_kinematics import ARMS, jacobian, joint_speeds

_STEP_RAD = 0.05
"""Turn of all joints together between two places that are looked at."""


def capped_speed(
    model: ArmModelName,
    q_from: ArrayLike,
    q_to: ArrayLike,
    speed_rad_s: float,
    flange_speed_m_s: float,
) -> float:
    """The leading joint's speed, rad/s, for the straight joint move between the angles (6,).

    At most `speed_rad_s` and what each joint can do, and such that the flange's origin stays below `flange_speed_m_s`
    all along the line: proven between the places looked at, so at most 1 % or so too slow.
    """
    turn = np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64)
    furthest = float(np.abs(turn).max())
    if furthest == 0.0:
        return float(min(speed_rad_s, joint_speeds(model).min()))
    by_joints = float((joint_speeds(model) / (np.abs(turn) / furthest).clip(min=1e-12)).min())
    by_flange = flange_speed_m_s * furthest / greatest_shift(model, q_from, q_to)
    return min(speed_rad_s, by_joints, by_flange)


def greatest_shift(model: ArmModelName, q_from: ArrayLike, q_to: ArrayLike) -> float:
    """Greatest speed of the flange's origin, metres per whole move, were the straight joint line passed evenly.

    An upper bound, near to the true one.
    """
    start = np.asarray(q_from, dtype=np.float64)
    turn = np.asarray(q_to, dtype=np.float64) - start
    total = float(np.abs(turn).sum())
    steps = int(np.ceil(total / _STEP_RAD)) + 1
    places: NDArray[np.float64] = start + np.linspace(0.0, 1.0, steps + 1)[:, None] * turn
    speed = np.linalg.norm(jacobian(model, places)[:, :3] @ turn, axis=1)
    # Between two places a velocity lies within h^2 / 8 max |v''| of the chord; each derivative along the line brings at
    # most a factor of the joints' turns together, on a lever no longer than the stretched arm.
    arm = ARMS[model]
    lever = float(np.abs(arm.a_m).sum() + np.abs(arm.d_m).sum())
    return float(speed.max()) + lever * total**3 / (8 * steps**2)
