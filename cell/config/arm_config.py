"""Settings of the arm: model, limits of motion, address."""

import ipaddress
import math
import re
from typing import Literal

from pydantic import Field, field_validator

from cell.config.arm_models import ArmModelName, simulated_serial
from cell.config.strict_model import StrictSettings, Vector6


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.IPv4Address(address).is_loopback
    except ValueError:
        return False


class ArmSettings(StrictSettings):
    """Settings that every kind of arm has."""

    # a subclass adds `kind`

    model: ArmModelName = "ur5e"
    """Model of the arm. The planner takes its kinematics and link sizes from it."""
    speed_rad_s: float = Field(default=1.0, gt=0, le=3.14)
    """Speed of the fastest joint in a move."""
    acceleration_rad_s2: float = Field(default=1.4, gt=0, le=14.0)
    """Acceleration of the fastest joint in a move."""
    flange_speed_m_s: float = Field(default=0.25, gt=0, le=2.0)
    """Speed limit of the flange. A move that would exceed it is slowed down."""
    stop_deceleration_m_s2: float = Field(default=4.0, ge=1.0, le=15.0)
    """Deceleration of the flange after a stop."""
    watchdog_hz: float = Field(default=2.5, ge=1.0, le=50.0)
    """Watchdog rate. The controller stops a moving arm if the service is silent for 1 / `watchdog_hz` seconds."""
    home_q_rad: Vector6 | None = None
    """Joint angles of the home posture, where a scan ends. Without it, the planner chooses a posture."""

    @property
    def serial(self) -> str | None:
        """Serial number of the robot, or None if the settings do not determine it."""
        return None

    @field_validator("home_q_rad")
    @classmethod
    def _turns(cls, value: Vector6 | None) -> Vector6 | None:
        if value is not None and max(map(abs, value)) > 2 * math.pi:
            raise ValueError("a joint turns from -2 pi to 2 pi; angles are radians, not degrees")
        return value


class SimulatedArm(ArmSettings):
    """The virtual UR controller, which runs as a separate process on this machine."""

    kind: Literal["simulated"] = "simulated"
    """Selects the simulated arm."""
    host: str | None = None
    """Loopback address of the virtual controller, not 127.0.0.1. The default is the first free address from 127.0.0.2
    on."""
    time_factor: float = Field(default=1.0, ge=0.1, le=100.0)
    """Factor on the speed of the simulated arm. 2 makes it twice as fast."""
    pose_error_m: float = Field(default=0.0, ge=0.0, le=0.01)
    """Root mean square of a smooth error of the reported position. Real UR arms have 0.0003 to 0.0012."""
    pose_error_rad: float = Field(default=0.0, ge=0.0, le=0.02)
    """Root mean square of a smooth error of the reported orientation. Real UR arms have 0.0016 to 0.0037."""
    pose_error_seed: int = Field(default=0, ge=0)
    """Random seed of these errors. Each arm has its own."""

    @property
    def serial(self) -> str:
        """Serial number that the virtual controller reports."""
        return simulated_serial(self.model)

    @field_validator("host")
    @classmethod
    def _loopback(cls, value: str | None) -> str | None:
        # ur_rtde omits its check for remote control on 127.0.0.1: nothing is simulated there.
        if value is not None and not (_is_loopback(value) and value != "127.0.0.1"):
            raise ValueError('a simulated arm listens on 127.0.0.2 or above; a real one needs kind = "ur"')
        return value


class URArm(ArmSettings):
    """A UR e-Series robot, or its simulator URSim."""

    kind: Literal["ur"]
    """Selects a UR arm."""
    host: str
    """IP address or name of the controller."""

    @field_validator("host")
    @classmethod
    def _address(cls, value: str) -> str:
        if not re.fullmatch(r"[0-9A-Za-z]([0-9A-Za-z._-]*[0-9A-Za-z])?", value):
            raise ValueError('the controller\'s IP address or name alone is needed, as "192.168.1.10"')
        return value
