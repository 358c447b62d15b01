"""Read the flange pose of an arm for the simulated camera."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_models import ArmModelName

READ_HZ = 125.0
"""Rate at which a controller other than the virtual controller sends its joint angles, hertz."""

PoseSource = Callable[[], NDArray[np.float64]]
"""Function that returns the current flange pose `T_base_flange` (4, 4). It raises OSError if no controller answers."""


def controller_pose(host: str) -> PoseSource:
    """Return a source of the true flange pose of the virtual controller.

    No connection is made before the source is called.

    Args:
        host: Address of the virtual controller.
    """
    from cell.simulation.ur_controller.admin_client import AdminClient

    return AdminClient(host).pose


def reported_pose(model: ArmModelName, host: str) -> PoseSource:
    """Connect to a UR controller, and return a source of the flange pose.

    The source computes the flange pose from the reported joint angles by the nominal kinematics. The RTDE client may
    hang, or crash the process.

    Args:
        model: Model of the arm.
        host: Address of the controller, for example of URSim.

    Returns:
        Source of the flange pose. It raises ConnectionError after the connection ended.

    Raises:
        ConnectionError: No controller answers.
    """
    from rtde_receive import RTDEReceiveInterface

    from cell.kinematics import ur_kinematics

    try:
        receive = RTDEReceiveInterface(host, READ_HZ, ["timestamp", "actual_q"])
    except RuntimeError as error:
        raise ConnectionError(str(error)) from error

    def pose() -> NDArray[np.float64]:
        # Without a connection, the client returns the last joint angles.
        if not receive.isConnected():
            raise ConnectionError(f"the robot at {host} closed the connection")
        return ur_kinematics.forward(model, receive.getActualQ())

    return pose
