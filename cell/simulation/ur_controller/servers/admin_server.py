"""Admin server of the virtual controller: report the state and the log, and inject faults."""

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
    """Connection to the admin port.

    A request is one line of JSON, `{"call": name, "arguments": {...}}`, and so is its response, `{"answer": value}` or
    `{"error": message}`. The public methods below are the calls.
    """

    def __init__(self, robot: Robot, links: Links, listen: Callable[[bool], Awaitable[None]]) -> None:
        """Serve the admin calls for a robot.

        Args:
            robot: Virtual robot.
            links: Network link of the robot.
            listen: Accept (True) or refuse (False) connections to the robot's ports from now on.
        """
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
        """Handle the event of asyncio: answer the complete lines."""
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
        """Return the state of the robot, keyed as in `AdminClient.state`."""
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
            "watchdog_kicked_s": robot.watchdog.kicked_s,
            "watchdog_kicks": robot.watchdog.kicks,
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
        """Return the current pose of the flange."""
        return {"T_base_flange": self._robot.arm.T_base_flange.tolist()}

    def log(self, since: int) -> list[dict[str, Any]]:
        """Return the log from the event with number `since`."""
        return self._robot.log.since(since)

    def drop(self) -> None:
        """Reset all RTDE connections."""
        self._links.reset(RTDE_PORT)

    def freeze(self) -> None:
        """Hold back all RTDE traffic."""
        self._links.freeze(True)

    def half_open(self) -> None:
        """Accept new connections without answering them."""
        self._links.half_open = True

    async def unreachable(self) -> None:
        """Refuse connections to the robot's ports and reset the present ones."""
        await self._listen(False)
        self._links.reset(RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT)

    def slow(self, delay_s: float, rate_hz: float | None) -> None:
        """Delay RTDE packages by `delay_s`, and limit their rate to `rate_hz` unless None."""
        if not (delay_s >= 0 and (rate_hz is None or rate_hz > 0)):
            raise ValueError(f"delay_s {delay_s} must not be negative, rate_hz {rate_hz} must be positive")
        self._links.delay_s, self._links.rate_hz = delay_s, rate_hz

    def protective_stop(self, after_s: float, at_share: float | None) -> None:
        """Trigger a protective stop: now, after a time, or at a share (0 to 1) of the next move."""
        if at_share is not None:
            self._robot.planned_stop_shares.append(at_share)
        elif after_s > 0:
            self._robot.planned_stops_s.append(self._robot.now_s + after_s)
        else:
            self._robot.protective_stop("requested")

    def emergency_stop(self) -> None:
        """Press the emergency stop."""
        self._robot.emergency_stop(True)

    def local_mode(self) -> None:
        """Switch to local control. A running program continues, as on a real robot."""
        self._robot.remote = False

    def foreign_program(self, name: str) -> None:
        """Run a program that is not ur_rtde's."""
        self._robot.loaded = name
        self._robot.run_program(ForeignProgram(name))

    def power_off(self) -> None:
        """Turn the power off."""
        self._robot.power_off()

    def table(self, z_m: float | None) -> None:
        """Set the lowest allowed height of the flange in the base frame, or None for no limit."""
        self._robot.limits = SafetyLimits(z_m)

    async def clear(self) -> None:
        """End all injected faults."""
        self._links.clear()
        await self._listen(True)
        self._robot.planned_stops_s.clear()
        self._robot.planned_stop_shares.clear()
        self._robot.emergency_stop(False)
        self._robot.remote = True

    async def reset(self, q_rad: list[float] | None) -> None:
        """End all faults and restore the initial state, at joint angles (6,) unless None."""
        q = None if q_rad is None else np.array(q_rad, dtype=np.float64).reshape(6)
        await self.clear()
        self._robot.set_right(q)


QUESTIONS = frozenset({"state", "pose", "log"})
CALLS = QUESTIONS | {
    "drop", "freeze", "half_open", "unreachable", "slow", "protective_stop", "emergency_stop", "local_mode",
    "foreign_program", "power_off", "table", "clear", "reset",
}  # fmt: skip
