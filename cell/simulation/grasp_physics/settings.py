"""Settings of the physics simulation, and the errors of a robot that carries out a grasp."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class PhysicsSettings:
    """Material of the strings, force of the gripper, motion, and numerical parameters."""

    time_step_s: float = 0.002
    """Time step."""
    region_m: float = 0.075
    """Distance from the grasp, in the table plane, up to which strings are simulated. The palm reaches 0.06 m."""
    segment_m: float = 0.006
    """Approximate length of the rigid segments of a string."""
    density_kg_m3: float = 1100.0
    """Density of the strings. A string of r = 4.2 mm weighs 61 g per metre."""
    young_pa: float = 1.0e6
    """Effective modulus of bending and twisting. A string of r = 4.2 mm has a bending stiffness of 2.4e-4 N m^2, about
    that of a flexible cable."""
    damping_s: float = 0.02
    """Damping of bending and twisting, as a share of the stiffness, seconds."""
    string_friction: float = 0.4
    """Friction coefficient of strings, table and objects."""
    finger_friction: float = 0.4
    """Friction coefficient of the fingers, as of bare metal on plastic. Fingers with pads hold better."""
    grip_force_n: float = 20.0
    """Force of each finger."""
    raise_m: float = 0.08
    """Distance of the start from the grasp pose, against the approach direction."""
    lift_m: float = 0.06
    """Distance of the lift, against the approach direction."""
    descend_s: float = 0.25
    """Duration of the approach."""
    close_s: float = 0.12
    """Duration of closing."""
    lift_s: float = 0.25
    """Duration of the lift."""
    hold_s: float = 0.1
    """Duration of the hold after the lift."""


@dataclass(frozen=True)
class RobotError:
    """Rigid error of the robot. The gripper is displaced and rotated during the whole grasp."""

    name: str = "none"
    """Name for reports."""
    across_m: float = 0.0
    """Displacement along x of the grasp frame, the closing direction."""
    down_m: float = 0.0
    """Displacement downwards, along -z of the base frame."""
    rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector in the grasp frame, about the origin of the grasp."""

    def apply(self, T_base_grasp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pose (4, 4) that the gripper reaches in place of `T_base_grasp` (4, 4)."""
        T = T_base_grasp.copy()
        T[:3, 3] += self.across_m * T[:3, 0] - (0.0, 0.0, self.down_m)
        T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(self.rotation_rad).as_matrix()
        return T


NO_ERROR = RobotError()
"""The robot reaches each pose exactly."""


def robot_errors(distance_m: float = 0.001, angle_rad: float = float(np.deg2rad(1.0))) -> tuple[RobotError, ...]:
    """Return nine errors of a given size, one at a time: both ways across, down, and both ways about each axis."""
    shifts = (
        RobotError("+x", across_m=distance_m),
        RobotError("-x", across_m=-distance_m),
        RobotError("down", down_m=distance_m),
    )
    turns = tuple(
        RobotError(f"{'+' if sign > 0 else '-'}r{axis}", rotation_rad=(sign * turn[0], sign * turn[1], sign * turn[2]))
        for axis, turn in zip("xyz", np.eye(3) * angle_rad, strict=True)
        for sign in (1, -1)
    )
    return shifts + turns
