"""Errors that follow from the robot mode and the safety mode."""

from cell.devices import RobotMode, SafetyMode
from cell.errors import CellError, EmergencyStopError, ProtectiveStopError, RobotNotReadyError

UNLOCK_S = 5.0
"""Time after a protective stop during which the robot rejects unlocking."""


def mode_error(robot_mode: RobotMode, safety_mode: SafetyMode) -> CellError | None:
    """Return why a robot in these modes cannot be moved and what to do, or None if it can."""
    match safety_mode:
        case "normal" | "reduced":
            pass
        case "protective_stop":
            return ProtectiveStopError(
                "the robot is in a protective stop: look at the cell, clear what it ran into, then acknowledge"
            )
        case "system_emergency_stop" | "robot_emergency_stop":
            return EmergencyStopError(
                "an emergency stop is pressed: make the cell safe, release the button, switch the robot on again at "
                "its pendant, then acknowledge"
            )
        case "safeguard_stop":
            return RobotNotReadyError(
                "a safeguard stops the robot: close the door or leave the guarded zone, and reset it"
            )
        case "recovery":
            return RobotNotReadyError("the robot is outside its safety limits: move it back by hand at the pendant")
        case _:
            return RobotNotReadyError(
                f"the robot's safety system reports {safety_mode.replace('_', ' ')}: see the pendant's log; the safety "
                "system must be restarted there"
            )
    match robot_mode:
        case "running":
            return None
        case "power_off" | "power_on" | "idle" | "booting":
            return RobotNotReadyError(
                f"the robot's arm is not switched on ({robot_mode.replace('_', ' ')}): switch it on and release its "
                "brakes at the pendant"
            )
        case "backdrive":
            return RobotNotReadyError("the robot's arm is in freedrive: let go of the freedrive button")
        case _:
            return RobotNotReadyError(f"the robot is not ready ({robot_mode.replace('_', ' ')}): see its pendant")
