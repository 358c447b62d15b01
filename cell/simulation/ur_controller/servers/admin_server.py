"""The controller's own port: tells its state and log, and makes faults on demand."""

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from inspect import isawaitable
from typing import Any

import numpy as np

from cell.simulation.ur_controller.robot.robot import ForeignProgram, Robot
from cell.simulation.ur_controller.robot.safety_limits import SafetyLimits
from cell.simulation.ur_controller.servers.sockets import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT, Links


class AdminServer(asyncio.Protocol):
    """One connection to the admin port."""

    def __init__(self, robot: Robot, links: Links, listen: Callable[[bool], Awaitable[None]]) -> None:
        """`listen`: answers connections of the robot's own ports from now on, or refuses them."""
        self._robot, self._links, self._listen = robot, links, listen
        self._buffer = b""
        self._lines: list[bytes] = []
        self._answering: asyncio.Task[None] | None = None
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Handle the event of asyncio."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def connection_lost(self, exc: Exception | None) -> None:
        """Handle the event of asyncio."""
        if self._answering is not None:
            self._answering.cancel()

    def data_received(self, data: bytes) -> None:
        """Handle the event of asyncio: answers the lines that are whole."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        self._lines += lines
        if self._lines and (self._answering is None or self._answering.done()):
            self._answering = asyncio.get_running_loop().create_task(self._answer_all())

    async def _answer_all(self) -> None:
        while self._lines:
            answer = await self._answer(self._lines.pop(0))
            self._transport.write(json.dumps(answer).encode() + b"\n")

    async def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            name, arguments = request["call"], request["arguments"]
            if name not in CALLS:
                return {"error": f"there is no call {name!r}"}
            self._robot.advance(asyncio.get_running_loop().time())
            if name not in QUESTIONS:
                self._robot.log.add("fault", self._robot.now_s, fault=name, **arguments)
            answer = getattr(self, name)(**arguments)
            return {"answer": await answer if isawaitable(answer) else answer}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": f"{type(error).__name__}: {error}"}

    def state(self) -> dict[str, Any]:
        """The robot now."""
        robot, ports = self._robot, list(self._links.transports.values())
        return {
            "stamp_s": robot.now_s,
            "q_rad": robot.arm.q.tolist(),
            "qd_rad_s": robot.arm.qd.tolist(),
            "T_base_flange": robot.arm.T_base_flange.tolist(),
            "robot_mode": robot.mode.name,
            "safety_mode": robot.safety.name,
            "program_state": robot.runtime.name,
            "program": None if robot.program is None else robot.program.name,
            "moving": not robot.arm.still,
            "progress": robot.arm.progress,
            "watchdog_hz": robot.watchdog.hz,
            "watchdog_fed_s": robot.watchdog.fed_s,
            "watchdog_meals": robot.watchdog.meals,
            "remote": robot.remote,
            "speed_fraction": robot.arm.speed_fraction,
            "events": robot.log.count,
            "connections": {
                "rtde": ports.count(RTDE_PORT),
                "script": ports.count(SCRIPT_PORT),
                "dashboard": ports.count(DASHBOARD_PORT),
            },
        }

    def pose(self) -> dict[str, Any]:
        """Where the flange is now."""
        return {"T_base_flange": self._robot.arm.T_base_flange.tolist()}

    def log(self, since: int) -> list[dict[str, Any]]:
        """The events from a number on."""
        return self._robot.log.since(since)

    def drop(self) -> None:
        """Resets all RTDE connections."""
        self._links.reset(RTDE_PORT)

    def freeze(self) -> None:
        """Silence on RTDE."""
        self._links.freeze(True)

    def half_open(self) -> None:
        """New connections get no answer."""
        self._links.half_open = True

    async def unreachable(self) -> None:
        """Nobody can connect."""
        await self._listen(False)
        self._links.reset(RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT)

    def slow(self, delay_s: float, rate_hz: float | None) -> None:
        """Late or seldom packages."""
        if not (delay_s >= 0 and (rate_hz is None or rate_hz > 0)):
            raise ValueError(f"delay_s {delay_s} must not be negative, rate_hz {rate_hz} must be positive")
        self._links.delay_s, self._links.rate_hz = delay_s, rate_hz

    def protective_stop(self, after_s: float, at_share: float | None) -> None:
        """Now or later."""
        if at_share is not None:
            self._robot.planned_stop_shares.append(at_share)
        elif after_s > 0:
            self._robot.planned_stops_s.append(self._robot.now_s + after_s)
        else:
            self._robot.protective_stop("asked for")

    def emergency_stop(self) -> None:
        """The red button."""
        self._robot.emergency_stop(True)

    def local_mode(self) -> None:
        """Local control; a running program goes on, as on a real robot."""
        self._robot.remote = False

    def foreign_program(self, name: str) -> None:
        """Another program runs."""
        self._robot.loaded = name
        self._robot.run_program(ForeignProgram(name))

    def power_off(self) -> None:
        """No power."""
        self._robot.power_off()

    def table(self, z_m: float | None) -> None:
        """A safety plane."""
        self._robot.limits = SafetyLimits(z_m)

    async def clear(self) -> None:
        """Ends the faults."""
        self._links.clear()
        await self._listen(True)
        self._robot.planned_stops_s.clear()
        self._robot.planned_stop_shares.clear()
        self._robot.emergency_stop(False)
        self._robot.remote = True

    async def reset(self, q_rad: list[float] | None) -> None:
        """Everything right again."""
        q = None if q_rad is None else np.array(q_rad, dtype=np.float64).reshape(6)
        await self.clear()
        self._robot.set_right(q)


QUESTIONS = frozenset({"state", "pose", "log"})
CALLS = QUESTIONS | {
    "drop", "freeze", "half_open", "unreachable", "slow", "protective_stop", "emergency_stop", "local_mode",
    "foreign_program", "power_off", "table", "clear", "reset",
}  # fmt: skip
