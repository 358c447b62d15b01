"""How the simulated camera learns where the arm carries it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import ArmModelName

READ_HZ = 125.0
"""How often a controller that is not ours tells the joint angles."""

PoseSource = Callable[[], NDArray[np.float64]]
"""Tells the flange pose (4, 4) in the base frame at the moment of the call. Raises OSError."""


def controller_pose(host: str) -> PoseSource:
    """The flange pose as the virtual controller at `host` tells it. Raises OSError."""
    from cell.simulation.ur_controller.admin_client import AdminClient

    return AdminClient(host).pose


def reported_pose(model: ArmModelName, host: str) -> PoseSource:
    """The flange pose by the joint angles that any UR controller at `host`, as URSim's, tells over RTDE, and by the
    nominal table of its arm. For a process that may hang or crash with the vendor's library. Raises OSError.
    """
    from rtde_receive import RTDEReceiveInterface

    from cell.kinematics import ur_kinematics

    try:
        receive = RTDEReceiveInterface(host, READ_HZ, ["timestamp", "actual_q"])
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error

    def pose() -> NDArray[np.float64]:
        if not receive.isConnected():  # what it tells then is old
            raise ConnectionError(f"the robot at {host} has ended the connection")
        return ur_kinematics.forward(model, receive.getActualQ())

    return pose
