"""Duration of joint moves: constant acceleration of the leading joint, its capped speed, and deceleration to rest.

The durations are those of the controller's motion at full speed slider. Around each move, the driver needs about
0.1 s more, for the start and the wait until the arm is at rest.
"""

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import ArmSettings
from cell.kinematics.joint_paths import JointPath
from cell.kinematics.speed_cap import capped_speeds


def move_durations(arm: ArmSettings, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the durations (N,) of straight joint moves from rest to rest, seconds.

    Args:
        arm: Model, speeds and acceleration of the arm.
        q_from: Joint angles (N, 6) at the start of each move, or (6,) for all.
        q_to: Joint angles (N, 6) at the end of each move, or (6,) for all.
    """
    start, end = np.broadcast_arrays(np.atleast_2d(q_from), np.atleast_2d(q_to))
    length = np.abs(end - start).max(axis=1)
    speed = capped_speeds(arm.model, start, end, arm.speed_rad_s, arm.flange_speed_m_s)
    acceleration = arm.acceleration_rad_s2
    # a short move has no constant speed
    ramp = np.minimum(speed / acceleration, np.sqrt(length / acceleration))
    cruise = np.divide(length, acceleration * ramp, out=np.zeros_like(ramp), where=length > 0)
    return ramp + cruise


def path_duration(arm: ArmSettings, q_from: NDArray[np.float64], path: JointPath) -> float:
    """Return the duration of a path, seconds. The arm is at rest at each waypoint."""
    waypoints = np.array([q_from, *path])
    return float(move_durations(arm, waypoints[:-1], waypoints[1:]).sum())
