"""Statuses of a cell for tests of what the service says about it."""

import time

import numpy as np

from cell.control.status import CellStatus, State
from cell.devices import ArmState


def status_with_arm(state: State, angle_rad: float = 0.0, age_s: float = 0.0, moving: bool = False) -> CellStatus:
    """Return a status with an arm whose joints are all at one angle and whose state has this age."""
    arm = ArmState(
        q_rad=np.full(6, angle_rad),
        qd_rad_s=np.zeros(6),
        T_base_flange=np.eye(4),
        robot_mode="running",
        safety_mode="normal",
        moving=moving,
        controller_s=0.0,
        age_s=0.0,
        read_s=time.monotonic() - age_s,
    )
    return CellStatus(state=state, slug=None, reason=None, arm_state=arm)
