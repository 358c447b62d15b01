"""Sources of the flange pose, from which the simulated camera knows where it is."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import ArmModelName

READ_HZ = 125.0
"""Rate of the joint angles of a controller that is not the virtual one."""

PoseSource = Callable[[], NDArray[np.float64]]
"""Returns the flange pose (4, 4) in the base frame at the time of the call. It raises OSError without a controller."""


def controller_pose(host: str) -> PoseSource:
    """Return a source of the true flange pose of the virtual controller at `host`. Raise OSError without one."""
    from cell.simulation.ur_controller.admin_client import AdminClient

    return AdminClient(host).pose


def reported_pose(model: ArmModelName, host: str) -> PoseSource:
    """Return a source of the flange pose by nominal kinematics and the joint angles of any UR controller.

    Args:
        model: Model of the arm.
        host: Address of the controller, for example URSim's. Its RTDE client may hang or crash the process.

    Raises:
        OSError: No controller answers.
    """
    from rtde_receive import RTDEReceiveInterface

    from cell.kinematics import ur_kinematics

    try:
        receive = RTDEReceiveInterface(host, READ_HZ, ["timestamp", "actual_q"])
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error

    def pose() -> NDArray[np.float64]:
        if not receive.isConnected():  # its values are then old
            raise ConnectionError(f"the robot at {host} has ended the connection")
        return ur_kinematics.forward(model, receive.getActualQ())

    return pose
