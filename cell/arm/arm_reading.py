"""What a reading of the controller means for the arm that is driven."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.arm.ur_reading import Reading
from cell.devices import ArmState
from cell.errors import RobotLostError

FRESH_S = 0.3
"""A controller whose clock stands still for longer is lost."""
STEADY_RAD_S = 3e-3
"""At rest every joint is slower than this."""


def arm_state(reading: Reading, T_flange_tcp: NDArray[np.float64], stopped: bool) -> ArmState:
    """The reading as a state. `T_flange_tcp`: the tool that its tool pose is of; `stopped`: the arm was, by request."""
    T_base_tcp = from_rotation_vector(reading.base_tcp[:3], reading.base_tcp[3:])
    # A stop is an operation too, and one that a program's end has cut short never ends.
    under_way = reading.operating and reading.program == "playing" and not stopped
    return ArmState(
        q_rad=np.array(reading.q_rad),
        qd_rad_s=np.array(reading.qd_rad_s),
        T_base_flange=T_base_tcp @ inverse(T_flange_tcp),
        robot_mode=reading.robot_mode,
        safety_mode=reading.safety_mode,
        moving=under_way or fastest(reading) > STEADY_RAD_S,
        controller_s=reading.controller_s,
        age_s=reading.age_s,
    )


def silence(reading: Reading) -> RobotLostError | None:
    """That the controller is not heard any more; None if it is."""
    if not reading.connected:
        return RobotLostError(
            "the connection to the robot broke: check the network cable and the robot's controller, then connect again"
        )
    if reading.age_s > FRESH_S:
        return RobotLostError(
            f"nothing new was heard from the robot for {reading.age_s:.1f} s: check the network cable and the robot's "
            "controller, then connect again"
        )
    return None


def fastest(reading: Reading) -> float:
    """Speed of the fastest joint, rad/s."""
    return max(abs(qd) for qd in reading.qd_rad_s)
