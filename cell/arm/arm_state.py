"""Interpretation of what the controller reports about the arm."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.arm.rtde_state import RtdeState
from cell.devices import ArmState
from cell.errors import RobotLostError

MAX_AGE_S = 0.3
"""Largest age of the controller's data. The clock of a lost controller stands still."""
STEADY_RAD_S = 3e-3
"""Largest joint speed of an arm at rest."""


def arm_state(reading: RtdeState, T_flange_tcp: NDArray[np.float64], stopped: bool) -> ArmState:
    """Convert a reading to the state of the arm.

    Args:
        reading: What the controller reports.
        T_flange_tcp: Tool pose (4, 4) on the flange, to which the reported TCP pose belongs.
        stopped: Whether the arm was stopped by request.
    """
    T_base_tcp = from_rotation_vector(reading.base_tcp[:3], reading.base_tcp[3:])
    # a stop is an operation too, and it never ends if the program ended first
    under_way = reading.operating and reading.program == "playing" and not stopped
    return ArmState(
        q_rad=np.array(reading.q_rad),
        qd_rad_s=np.array(reading.qd_rad_s),
        T_base_flange=T_base_tcp @ inverse(T_flange_tcp),
        robot_mode=reading.robot_mode,
        safety_mode=reading.safety_mode,
        moving=under_way or max_joint_speed(reading) > STEADY_RAD_S,
        controller_s=reading.controller_s,
        age_s=reading.age_s,
    )


def lost_connection_error(reading: RtdeState) -> RobotLostError | None:
    """Return the error if the controller sends no new data, or None."""
    if not reading.connected:
        return RobotLostError(
            "the connection to the robot broke: check the network cable and the robot's controller, then connect again"
        )
    if reading.age_s > MAX_AGE_S and reading.silent_s > reading.age_s / 2:
        return RobotLostError(
            f"nothing new of the robot was read for {reading.age_s:.1f} s, and this computer stood still for "
            f"{reading.silent_s:.1f} s: end other work on this computer, then connect again"
        )
    if reading.age_s > MAX_AGE_S:
        return RobotLostError(
            f"the robot has sent nothing new for {reading.age_s:.1f} s: check the network cable and the robot's "
            "controller, then connect again"
        )
    return None


def max_joint_speed(reading: RtdeState) -> float:
    """Return the speed of the fastest joint, rad/s."""
    return max(abs(qd) for qd in reading.qd_rad_s)
