"""Dashboard server: one line of text a request and a response."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from cell.simulation.ur_controller.robot.arm import HANDOVER_RAD_S2
from cell.simulation.ur_controller.robot.robot import Robot
from cell.simulation.ur_controller.robot.states import RuntimeState
from cell.simulation.ur_controller.servers.sockets import DASHBOARD_PORT, Links

GREETING = "Connected: Universal Robots Dashboard Server"
NOT_REMOTE = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to port "
    "29999"
)
TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
REMOTE_ONLY = (
    "load", "play", "stop", "pause", "power on", "power off", "brake release", "unlock protective stop",
    "restart safety",
)  # fmt: skip
LONGEST_LINE = 4096
STOP_POLL_S = 0.004

STOPPED, PAUSING, DISCONNECTED = "Stopped", "Pausing program", "Disconnected"

MODELS = {"ur3e": "UR3", "ur5e": "UR5", "ur10e": "UR10"}
"""Model names as the controller reports them, without the e."""


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


class DashboardServer(asyncio.Protocol):
    """Connection to the dashboard."""

    def __init__(self, robot: Robot, links: Links, identity: Identity) -> None:
        self._robot, self._links, self._identity = robot, links, identity
        self._buffer = b""
        self._answering: asyncio.Task[None] | None = None
        self._answers: list[str] = []
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Handle the event of asyncio."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._peer = list(transport.get_extra_info("peername") or ())
        self._robot.log.add("connected", port=DASHBOARD_PORT, peer=self._peer)
        if self._links.opened(transport, DASHBOARD_PORT):
            self._write(GREETING)

    def connection_lost(self, exc: Exception | None) -> None:
        """Handle the event of asyncio."""
        self._robot.log.add("disconnected", port=DASHBOARD_PORT, peer=self._peer)
        self._links.closed(self._transport)
        if self._answering is not None:
            self._answering.cancel()

    def data_received(self, data: bytes) -> None:
        """Handle the event of asyncio: process the complete lines."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if len(self._buffer) > LONGEST_LINE:
            self._transport.abort()
            return
        for line in lines:
            # A stop takes effect when it is read; its answer is sent when the arm is at rest.
            self._answers.append(self._take(line.decode(errors="replace").strip()))
        if self._answers and (self._answering is None or self._answering.done()):
            self._answering = asyncio.get_running_loop().create_task(self._answer())

    async def _answer(self) -> None:
        """Send the answers in order; hold the answer to a stop until the arm is at rest."""
        while self._answers:
            answer = self._answers.pop(0)
            while answer in (STOPPED, PAUSING) and not self._robot.arm.still:
                await asyncio.sleep(STOP_POLL_S)
            self._write(answer)
            if answer == DISCONNECTED:
                self._transport.close()
                return

    def _write(self, text: str) -> None:
        if not self._transport.is_closing():
            self._transport.write(text.encode() + b"\n")

    def _take(self, request: str) -> str:
        """Execute a request and return its answer."""
        robot = self._robot
        robot.advance(asyncio.get_running_loop().time())
        lowered = request.lower()
        refused = not robot.remote and lowered.startswith(REMOTE_ONLY)
        answer = NOT_REMOTE if refused else self._do(request, lowered)
        robot.log.add("dashboard", robot.now_s, command=request[:200], answer=answer)
        return answer

    def _do(self, command: str, lowered: str) -> str:
        if lowered in _ACTIONS:
            return _ACTIONS[lowered](self._robot)
        if lowered in _QUESTIONS:
            return _QUESTIONS[lowered](self._robot, self._identity)
        for start, answer in _ANSWERS.items():
            if lowered.startswith(start):
                return answer
        if lowered.startswith("load "):
            return f"File not found: {command[5:]}"
        return f"could not understand: '{command[:200]}'"


def _power_on(robot: Robot) -> str:
    robot.power_on()
    return "Powering on"


def _power_off(robot: Robot) -> str:
    robot.power_off()
    return "Powering off"


def _brake_release(robot: Robot) -> str:
    robot.release_brakes()
    return "Brake releasing"


_ACTIONS: dict[str, Callable[[Robot], str]] = {
    "play": lambda robot: "Starting program" if robot.play() else "Failed to execute: play",
    "stop": lambda robot: STOPPED if robot.stop_program("dashboard stop") else "Failed to execute: stop",
    "pause": lambda robot: (
        PAUSING if robot.pause_program(HANDOVER_RAD_S2, "dashboard pause") else "Failed to execute: pause"
    ),
    "unlock protective stop": lambda robot: "Protective stop releasing" if robot.unlock() else TOO_EARLY,
    "power on": _power_on,
    "power off": _power_off,
    "brake release": _brake_release,
}


def _program(robot: Robot) -> str:
    return "<unnamed>" if robot.program is None else robot.program.name


def _program_state(robot: Robot) -> str:
    state = RuntimeState.STOPPED if robot.runtime is RuntimeState.STOPPING else robot.runtime
    return f"{state.name} {_program(robot)}"


_QUESTIONS: dict[str, Callable[[Robot, Identity], str]] = {
    "robotmode": lambda robot, _: f"Robotmode: {robot.mode.name}",
    "safetymode": lambda robot, _: f"Safetymode: {robot.safety.name}",
    "safetystatus": lambda robot, _: f"Safetystatus: {robot.safety.name}",
    "running": lambda robot, _: f"Program running: {str(robot.runtime is RuntimeState.PLAYING).lower()}",
    "programstate": lambda robot, _: _program_state(robot),
    "get loaded program": lambda robot, _: f"Loaded program: {robot.loaded}" if robot.loaded else "No program loaded",
    "isprogramsaved": lambda robot, _: f"true {_program(robot)}",
    "is in remote control": lambda robot, _: str(robot.remote).lower(),
    "polyscopeversion": lambda _, identity: f"URSoftware {identity.software} (virtual)",
    "version": lambda _, identity: identity.software,
    "get serial number": lambda _, identity: identity.serial,
    "get robot model": lambda robot, _: MODELS[robot.arm.model],
    "get operational mode": lambda *_: "NONE",
}

_ANSWERS = {
    "quit": DISCONNECTED,
    "restart safety": "Restarting safety",
    "close safety popup": "closing safety popup",
    "close popup": "closing popup",
    "popup ": "showing popup",
    "addtolog ": "Added log message",
}
"""Answers to requests without effect here, by the prefix of the request."""
