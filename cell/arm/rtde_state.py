"""Data of a UR controller over RTDE, in the terms of the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # the imports take a second in the child process
    from cell.devices import RobotMode, SafetyMode

ROBOT_MODES: dict[int, RobotMode] = {
    -1: "no_controller", 0: "disconnected", 1: "confirm_safety", 2: "booting", 3: "power_off", 4: "power_on",
    5: "idle", 6: "backdrive", 7: "running", 8: "updating_firmware",
}  # fmt: skip
_SAFETY_MODES: dict[int, SafetyMode] = {
    1: "normal", 2: "reduced", 3: "protective_stop", 4: "recovery", 5: "safeguard_stop", 6: "system_emergency_stop",
    7: "robot_emergency_stop", 8: "violation", 9: "fault", 10: "validate_joint_id", 11: "undefined",
    12: "safeguard_stop", 13: "safeguard_stop", 14: "safeguard_stop",  # in automatic mode; by two enabling switches
}  # fmt: skip
_STOP_BITS: dict[int, SafetyMode] = {
    2: "protective_stop", 4: "safeguard_stop", 5: "system_emergency_stop", 6: "robot_emergency_stop",
    7: "robot_emergency_stop", 8: "violation", 9: "fault",
}  # fmt: skip

Program = Literal["playing", "paused", "stopped"]
PROGRAMS: dict[int, Program] = {2: "playing", 3: "paused", 4: "paused", 5: "paused"}


@dataclass(frozen=True)
class RtdeState:
    """Last data of the controller."""

    q_rad: tuple[float, ...]
    """Actual joint angles (6,), rad."""
    qd_rad_s: tuple[float, ...]
    """Actual joint speeds (6,), rad/s."""
    base_tcp: tuple[float, ...]
    """Actual TCP pose (6,) in the base frame, position in metres and rotation vector in radians."""
    controller_s: float
    """Clock of the controller, seconds since its start."""
    age_s: float
    """Time since that clock was last seen to move, seconds."""
    connected: bool
    """Whether both connections are up, as far as is known."""
    robot_mode: RobotMode
    """Robot mode."""
    safety_mode: SafetyMode
    """Safety mode."""
    program: Program
    """State of the control script."""
    operation: int
    """Number of the last asynchronous move or stop. After 127 it restarts at 0."""
    operating: bool
    """Whether that move or stop runs."""
    speed_fraction: float
    """Speed slider of the pendant, 0 to 1."""
    silent_s: float = 0.0
    """Longest time for which this computer sent nothing to the watchdog of a running program, in the last seconds."""
    still_s: float = 0.0
    """Longest time for which the process of the driver read nothing, in the last seconds. It reads often."""


def decode_safety_mode(mode: int, bits: int) -> SafetyMode:
    """Return the safety mode of RTDE's mode and status bits. The bits report a stop earlier, and more kinds of stop."""
    said: SafetyMode = _SAFETY_MODES.get(mode, "undefined")
    if said in ("normal", "reduced"):
        for bit, stop in _STOP_BITS.items():
            if bits >> bit & 1:
                return stop
    return said
