"""Limits of the simulated safety system."""

import math
from dataclasses import dataclass
from functools import cache

from cell.config.arm_models import ArmModelName
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.trajectories import Joints

JOINT_MARGIN_RAD = math.radians(3.0)
"""Margin of the joint limits. The default safety configuration allows 363 degrees."""


@dataclass(frozen=True)
class SafetyLimits:
    """Allowed region of the arm."""

    table_z_m: float | None = None
    """Height of a safety plane below which the flange must not go, or None."""

    def violation(self, model: ArmModelName, q: Joints) -> str | None:
        """Return a description of the violated limit at the joint angles (6,), or None."""
        # plain floats, because numpy calls would dominate at the rate of the stream
        for k, (angle, limit) in enumerate(zip(q.tolist(), _limits(model), strict=True)):
            if not abs(angle) <= limit:
                return f"joint {k + 1} at {math.degrees(angle):.1f} degrees is beyond its limit"
        if self.table_z_m is None:
            return None
        z = float(ur_kinematics.forward(model, q)[2, 3])
        if z < self.table_z_m:
            return f"the flange at z = {z:.3f} m is below the plane at {self.table_z_m:.3f} m"
        return None


@cache
def _limits(model: ArmModelName) -> tuple[float, ...]:
    return tuple((ur_kinematics.joint_limits(model) + JOINT_MARGIN_RAD).tolist())
