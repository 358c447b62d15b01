"""The virtual controller: its ports and its cycle."""

import asyncio
import functools
import socket
from dataclasses import dataclass

import numpy as np

from cell.config.arm_models import ArmModelName, simulated_serial
from cell.simulation.kinematic_error import KinematicError
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.robot import Robot
from cell.simulation.ur_controller.robot.safety_limits import SafetyLimits
from cell.simulation.ur_controller.servers.admin_server import AdminServer
from cell.simulation.ur_controller.servers.dashboard_requests import Identity
from cell.simulation.ur_controller.servers.dashboard_server import DashboardServer
from cell.simulation.ur_controller.servers.rtde_server import RtdeClient, RtdeServer
from cell.simulation.ur_controller.servers.script_server import ScriptServer
from cell.simulation.ur_controller.servers.sockets import (
    ADMIN_PORT,
    DASHBOARD_PORT,
    RTDE_PORT,
    SCRIPT_PORT,
    Links,
    bound,
)

IDLE_STEPS = 10
"""Control cycles from one run to the next without clients and motion, to save processor time."""
HOME_Q_RAD = tuple(np.deg2rad((0.0, -90.0, 90.0, -90.0, -90.0, 0.0)).tolist())
LATE_S = 0.02
"""Delay beyond which cycles were held up by other work of the machine and are omitted. Later ones are made up for."""


@dataclass(frozen=True)
class ControllerOptions:
    """Options of a virtual controller."""

    model: ArmModelName
    q_rad: tuple[float, ...]
    """Joint angles (6,) at the start."""
    time_factor: float
    """Factor on the speed of the arm, and of nothing else."""
    table_z_m: float | None
    """Height of a safety plane, or None. See SafetyLimits."""
    version: tuple[int, int, int, int]
    """Software version that the controller reports."""
    pose_error_m: float = 0.0
    """Root mean square of the reported position's smooth error. 0 reports the pose by nominal kinematics."""
    pose_error_rad: float = 0.0
    """Root mean square of the reported orientation's smooth error."""
    seed: int = 0
    """Seed of that error."""


async def serve(options: ControllerOptions, sockets: dict[int, socket.socket]) -> None:
    """Run the controller on listening sockets. It ends only by an error of its cycle."""
    loop = asyncio.get_running_loop()
    log, links = EventLog(), Links()
    q_rad = np.array(options.q_rad, dtype=np.float64)
    error = None
    if options.pose_error_m > 0 or options.pose_error_rad > 0:
        error = KinematicError(options.pose_error_m, options.pose_error_rad, options.seed)
    limits = SafetyLimits(options.table_z_m)
    robot = Robot(options.model, q_rad, options.time_factor, limits, log, loop.time(), error)
    rtde = RtdeServer(robot, links, options.version)
    identity = Identity(options.version, serial=simulated_serial(options.model))

    async def shut_down() -> None:
        robot.power_off()
        await listeners.listen(False)
        links.reset(RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT)

    listeners = _Listeners(
        sockets,
        {
            RTDE_PORT: functools.partial(RtdeClient, rtde),
            SCRIPT_PORT: functools.partial(ScriptServer, robot, links),
            DASHBOARD_PORT: functools.partial(DashboardServer, robot, links, identity, shut_down),
        },
    )
    await listeners.listen(True)
    await loop.create_server(lambda: AdminServer(robot, links, listeners.listen), sock=sockets[ADMIN_PORT])
    end = loop.create_future()
    cycle = _Cycle(robot, rtde, end)
    cycle.run()
    await end


class _Cycle:
    """The cycle of the controller. Its time is a count of cycles, which keeps in step with the clock.

    It is a chain of timer calls, because a sleeping coroutine costs 50 % more.
    """

    def __init__(self, robot: Robot, rtde: RtdeServer, end: "asyncio.Future[None]") -> None:
        self._robot, self._rtde, self._end = robot, rtde, end
        self._loop = asyncio.get_running_loop()
        self._due_step = 0

    def run(self) -> None:
        """Run the cycles that are due and schedule the next one."""
        try:
            self._run(self._loop.time())
        except Exception as error:  # noqa: BLE001 (passed to the task that waits for the end)
            if not self._end.done():
                self._end.set_exception(error)

    def _run(self, now_s: float) -> None:
        robot, rtde = self._robot, self._rtde
        step, due_s = self._due_step, robot.time_of(self._due_step)
        last = max(step, robot.step_at(now_s))
        if now_s - due_s > LATE_S:  # a real controller is never held up
            robot.watchdog.excuse(due_s, now_s)
            step = last
        while step <= last:
            robot.begin_cycle(step)
            robot.cycle()
            rtde.send(step)
            step += 1 if rtde.streaming or robot.arm.busy else IDLE_STEPS
        self._due_step = step
        self._loop.call_at(robot.time_of(step), self.run)


class _Listeners:
    """The ports of the robot, which accept or refuse connections."""

    def __init__(self, sockets: dict[int, socket.socket], makers: dict[int, functools.partial]) -> None:
        self._sockets, self._makers = sockets, makers
        self._servers: dict[int, asyncio.Server] = {}

    async def listen(self, on: bool) -> None:
        """Answers connections from now on, or refuses them."""
        loop = asyncio.get_running_loop()
        for port, maker in self._makers.items():
            if on and port not in self._servers:
                self._servers[port] = await loop.create_server(maker, sock=self._sockets[port])
            elif not on and port in self._servers:
                host = self._sockets[port].getsockname()[0]
                self._servers.pop(port).close()
                # bound but not listening, so that connections are refused and the port stays reserved
                self._sockets[port] = bound(host, port)
