"""Dashboard server: one line of text a request and a response."""

import asyncio
from collections.abc import Awaitable, Callable

from cell.simulation.ur_controller.robot.robot import Robot
from cell.simulation.ur_controller.servers import dashboard_requests
from cell.simulation.ur_controller.servers.dashboard_requests import (
    DISCONNECTED,
    PAUSING,
    SHUTTING_DOWN,
    STOPPED,
    Identity,
)
from cell.simulation.ur_controller.servers.sockets import DASHBOARD_PORT, Links

GREETING = "Connected: Universal Robots Dashboard Server"
LONGEST_LINE = 4096
STOP_POLL_S = 0.004


class DashboardServer(asyncio.Protocol):
    """Connection to the dashboard."""

    def __init__(
        self, robot: Robot, links: Links, identity: Identity, shut_down: Callable[[], Awaitable[None]]
    ) -> None:
        """Serve one client.

        Args:
            robot: Virtual robot.
            links: Network link of the robot.
            identity: Identity that the controller reports.
            shut_down: Shuts the controller down.
        """
        self._robot, self._links, self._identity, self._shut_down = robot, links, identity, shut_down
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
            if answer in (DISCONNECTED, SHUTTING_DOWN):
                self._transport.close()
            if answer == SHUTTING_DOWN:
                await self._shut_down()
            if self._transport.is_closing():
                return

    def _write(self, text: str) -> None:
        if not self._transport.is_closing():
            self._transport.write(text.encode() + b"\n")

    def _take(self, request: str) -> str:
        """Execute a request and return its answer."""
        robot = self._robot
        robot.advance(asyncio.get_running_loop().time())
        answer = dashboard_requests.answer(robot, self._identity, request)
        robot.log.add("dashboard", robot.now_s, command=request[:200], answer=answer)
        return answer
