"""Dashboard requests: their names, what they do, and their answers in the wording of the real server."""

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePosixPath

from cell.simulation.ur_controller.robot.arm import HANDOVER_RAD_S2
from cell.simulation.ur_controller.robot.robot import Robot
from cell.simulation.ur_controller.robot.states import OperationalMode, RuntimeState

NOT_REMOTE = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port "
    "29999"
)
TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
STOPPED, PAUSING, DISCONNECTED, SHUTTING_DOWN = "Stopped", "Pausing program", "Disconnected", "Shutting down"

MODELS = {"ur3e": "UR3", "ur5e": "UR5", "ur10e": "UR10"}
"""Model names as the controller reports them, without the e."""
INSTALLATION = "default.installation"
"""The only installation file of the virtual controller."""
REPORT_TYPES = ("", "controller", "software", "system")
"""Types of flight reports. Without a type, the report is one of the system."""


@dataclass(frozen=True)
class Identity:
    """Identity that the controller reports."""

    version: tuple[int, int, int, int]
    """Software version: major, minor, bugfix and build."""
    serial: str
    """Serial number."""

    @property
    def software(self) -> str:
        """Software version as the dashboard formats it."""
        major, minor, bugfix, build = self.version
        return f"{major}.{minor}.{bugfix}.{build}"


def answer(robot: Robot, identity: Identity, line: str) -> str:
    """Execute a request and return its answer.

    Args:
        robot: Virtual robot.
        identity: Identity that the controller reports.
        line: Request without its line break. The case of its name does not matter.
    """
    lowered = line.lower()
    for name in _NAMES:
        if lowered == name or (name in _WITH_ARGUMENT and lowered.startswith(f"{name} ")):
            if name in _REMOTE_ONLY and not robot.remote:
                return NOT_REMOTE
            return _REQUESTS[name](robot, identity, line[len(name) :].strip())
    return f"could not understand: '{line[:200]}'"


def _power_on(robot: Robot, *_: object) -> str:
    robot.power_on()
    return "Powering on"


def _power_off(robot: Robot, *_: object) -> str:
    robot.power_off()
    return "Powering off"


def _brake_release(robot: Robot, *_: object) -> str:
    robot.release_brakes()
    return "Brake releasing"


def _restart_safety(robot: Robot, *_: object) -> str:
    robot.restart_safety()
    return "Restarting safety"


def _pause(robot: Robot, *_: object) -> str:
    return PAUSING if robot.pause_program(HANDOVER_RAD_S2, "dashboard pause") else "Failed to execute: pause"


def _load_installation(_: Robot, __: Identity, file: str) -> str:
    return f"{'Loading installation' if PurePosixPath(file).name == INSTALLATION else 'File not found'}: {file}"


def _set_operational_mode(robot: Robot, _: Identity, mode: str) -> str:
    if mode.upper() not in (OperationalMode.MANUAL.name, OperationalMode.AUTOMATIC.name):
        return f"Failed setting operational mode: {mode}"
    robot.operational_mode = OperationalMode[mode.upper()]
    return f"Operational mode '{mode}' is set"


def _clear_operational_mode(robot: Robot, *_: object) -> str:
    robot.operational_mode = OperationalMode.NONE
    return f"No longer controlling the operational mode. Current operational mode: '{robot.operational_mode.name}'."


def _flight_report(_: Robot, __: Identity, kind: str) -> str:
    if kind.lower() not in REPORT_TYPES:
        return f"Failed to execute: generate flight report {kind}"
    return f"Flight Report generated with id: {uuid.uuid4()}"


def _support_file(_: Robot, identity: Identity, folder: str) -> str:
    if not folder:
        return "Error: no directory was given"
    return f"Completed successfully: ur_{identity.serial}_{datetime.now():%Y-%m-%d_%H-%M-%S}.zip"


def _program(robot: Robot) -> str:
    """Return the name of the running program, or else of the loaded one."""
    return robot.program.name if robot.program is not None else robot.loaded or "<unnamed>"


def _program_state(robot: Robot, *_: object) -> str:
    state = RuntimeState.STOPPED if robot.runtime is RuntimeState.STOPPING else robot.runtime
    return f"{state.name} {_program(robot)}"


_REQUESTS: dict[str, Callable[[Robot, Identity, str], str]] = {
    "play": lambda robot, *_: "Starting program" if robot.play() else "Failed to execute: play",
    "stop": lambda robot, *_: STOPPED if robot.stop_program("dashboard stop") else "Failed to execute: stop",
    "pause": _pause,
    "unlock protective stop": lambda robot, *_: "Protective stop releasing" if robot.unlock() else TOO_EARLY,
    "power on": _power_on,
    "power off": _power_off,
    "brake release": _brake_release,
    "restart safety": _restart_safety,
    "shutdown": lambda *_: SHUTTING_DOWN,
    "quit": lambda *_: DISCONNECTED,
    "load": lambda _robot, _identity, file: f"File not found: {file}",
    "load installation": _load_installation,
    "set operational mode": _set_operational_mode,
    "clear operational mode": _clear_operational_mode,
    "generate flight report": _flight_report,
    "generate support file": _support_file,
    "addtolog": lambda _robot, _identity, text: "Added log message" if text else "No log message to add",
    "savelog": lambda *_: "Log saved to disk",
    "popup": lambda *_: "showing popup",
    "close popup": lambda *_: "closing popup",
    "close safety popup": lambda *_: "closing safety popup",
    "robotmode": lambda robot, *_: f"Robotmode: {robot.mode.name}",
    "safetymode": lambda robot, *_: f"Safetymode: {robot.safety.name}",
    "safetystatus": lambda robot, *_: f"Safetystatus: {robot.safety.name}",
    "running": lambda robot, *_: f"Program running: {str(robot.runtime is RuntimeState.PLAYING).lower()}",
    "programstate": _program_state,
    "get loaded program": lambda robot, *_: f"Loaded program: {robot.loaded}" if robot.loaded else "No program loaded",
    "isprogramsaved": lambda robot, *_: f"true {_program(robot)}",
    "is in remote control": lambda robot, *_: str(robot.remote).lower(),
    "polyscopeversion": lambda _robot, identity, _argument: f"URSoftware {identity.software} (virtual)",
    "version": lambda _robot, identity, _argument: identity.software,
    "get serial number": lambda _robot, identity, _argument: identity.serial,
    "get robot model": lambda robot, *_: MODELS[robot.arm.model],
    "get operational mode": lambda robot, *_: robot.operational_mode.name,
}
_NAMES = sorted(_REQUESTS, key=len, reverse=True)
"""Names of the requests. Longer ones come first, because `load installation` begins like `load`."""
_WITH_ARGUMENT = frozenset({
    "load", "load installation", "set operational mode", "generate flight report", "generate support file", "addtolog",
    "popup",
})  # fmt: skip
_REMOTE_ONLY = frozenset({
    "load", "load installation", "play", "stop", "pause", "power on", "power off", "brake release",
    "unlock protective stop", "restart safety", "shutdown",
})  # fmt: skip
