"""What a UR controller says of itself over RTDE, in the words of the rest of the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:  # a second of imports that the child process can do without
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
class Reading:
    """The controller's last word."""

    q_rad: tuple[float, ...]
    """(6,) actual joint angles."""
    qd_rad_s: tuple[float, ...]
    """(6,) actual joint speeds."""
    base_tcp: tuple[float, ...]
    """(6,) actual pose of the tool's centre point: metres, axis-angle."""
    controller_s: float
    """The controller's clock."""
    age_s: float
    """How long ago that clock was last seen to move."""
    connected: bool
    """Both connections stand, as far as is known."""
    robot_mode: RobotMode
    safety_mode: SafetyMode
    program: Program
    """Of the control script."""
    operation: int
    """Number of the last asynchronous move or stop; starts again at 0 after 127."""
    operating: bool
    """That move or stop is under way."""
    speed_fraction: float
    """The pendant's speed slider, 0 to 1."""


def safety(mode: int, bits: int) -> SafetyMode:
    """The safety mode; the bits may know of a stop first, and of more kinds."""
    said: SafetyMode = _SAFETY_MODES.get(mode, "undefined")
    if said in ("normal", "reduced"):
        for bit, stop in _STOP_BITS.items():
            if bits >> bit & 1:
                return stop
    return said
