"""Drives a UR controller through ur_rtde: the part that lives in a child process, see `cell.process.child`.

Only short calls: each reads, or has one command taken by the control script that ur_rtde runs on the controller. Moves
are asynchronous there, watched by the parent's polls. What is known of ur_rtde 1.6.5 and minded here:

- Its constructors hold the interpreter's lock and may hang: the kernel's alarm ends the process then.
- On a lost link it reconnects by itself, uploads its script and sends its last command again. After the connection
  stands, this process is therefore not allowed to open any file or socket: a lost link ends it.
- A dead link goes unnoticed: readings carry how long ago the controller's clock last moved.
- `stopJ(..., asynchronous=True)` is taken at once, while a move runs; the script then decelerates the tool (stopl).
- Its objects take half a second each to close: the process is just ended.
"""

from __future__ import annotations

import functools
import math
import resource
import signal
import time
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from cell.arm.ur_reading import PROGRAMS, ROBOT_MODES, Reading, safety
from cell.errors import STOPPED, CellError, RobotLostError, RobotNotReadyError, RobotUnreachableError, StoppedError

CONNECT_S = 6.0
"""Longest that connecting may take; the script alone is given 5 s to start."""
CONTROL_HZ = 250.0
"""How often the controller answers commands: half of what it can do costs half, and is still 4 ms."""
READ_HZ = 125.0
"""How often the controller sends what is read here."""
LEASE_S = 5.0
"""Between moves the arm's watchdog is kept quiet for so long after the parent's last call."""
SAME_POSE = 1e-3
"""Tool poses of an arm at rest differ by less, metres and radians."""

_OPEN_FILES = 3
_VARIABLES = [
    "timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "robot_mode", "safety_mode", "safety_status_bits",
    "runtime_state", "target_speed_fraction",
]  # fmt: skip

P = ParamSpec("P")
R = TypeVar("R")


def _told_when_lost(
    method: Callable[Concatenate[UrDriver, P], R],
) -> Callable[Concatenate[UrDriver, P], R]:
    """ur_rtde raises a RuntimeError from whatever it does when it finds its connection broken."""

    @functools.wraps(method)
    def call(self: UrDriver, *arguments: P.args, **named: P.kwargs) -> R:
        try:
            return method(self, *arguments, **named)
        except CellError:
            raise
        except RuntimeError as error:
            raise RobotLostError(
                f"the connection to the robot broke ({error}): check the network cable and the robot's controller, "
                "then connect again"
            ) from error

    return call


class UrDriver:
    """One connection to one controller, in a process of its own."""

    def __init__(
        self, address: str, watchdog_hz: float, connect_s: float = CONNECT_S, lease_s: float = LEASE_S
    ) -> None:
        """Connects, uploads the control script and arms its watchdog. Ends a program that runs: probe first.

        Raises RobotUnreachableError, RobotNotReadyError.
        """
        from rtde_control import RTDEControlInterface as Control
        from rtde_receive import RTDEReceiveInterface as Receive

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.setitimer(signal.ITIMER_REAL, connect_s)
        try:
            self._receive = Receive(address, READ_HZ, _VARIABLES)
            # Without the flag the script would also claim the input for an external force sensor.
            self._control = Control(address, CONTROL_HZ, Control.FLAG_UPLOAD_SCRIPT | Control.FLAG_NO_EXT_FT)
        except RuntimeError as error:
            raise _not_connected(address, str(error)) from error
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))
        self.IDLE_S = 0.25 / watchdog_hz
        self._lease_s = lease_s
        self._moving = False
        self._stopped = False
        self._last_kick_s = 0.0
        self._clock_s, self._clock_moved_s = -1.0, time.monotonic()
        if not self._control.setWatchdog(watchdog_hz):
            raise RobotNotReadyError("the robot did not take the watchdog's frequency: connect again")

    @_told_when_lost
    def poll(self) -> Reading:
        """What the controller says now. A parent that polls also keeps the arm's watchdog quiet."""
        reading = self._reading()
        if self._moving and not reading.operating and reading.operation != self._operation_before:
            self._moving = False
        self._kick(reading)
        return reading

    @_told_when_lost
    def allows(self, q_rad: tuple[float, ...]) -> bool:
        """Whether the joint angles lie within the safety limits set at the controller."""
        return self._control.isJointsWithinSafetyLimits(list(q_rad))

    @_told_when_lost
    def start_move(self, q_rad: tuple[float, ...], speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Starts a joint move and returns at once: the number that its operation will differ from.

        Raises StoppedError, RobotNotReadyError.
        """
        if self._stopped:
            raise StoppedError(STOPPED)
        self._operation_before = self._control.getAsyncOperationProgressEx().operationId()
        self._moving = True
        if not self._control.moveJ(list(q_rad), speed_rad_s, acceleration_rad_s2, True):
            raise RobotNotReadyError("the robot did not take the move")
        return self._operation_before

    @_told_when_lost
    def stop(self, deceleration_m_s2: float) -> None:
        """Stops the arm; no move is sent by this process afterwards."""
        self._stopped = True
        # Asynchronous, as it must be while a move runs, the script makes a stopl of it: the number is of the tool.
        self._control.stopJ(deceleration_m_s2, True)

    @_told_when_lost
    def at_rest(self) -> tuple[Reading, tuple[float, ...]]:
        """What the controller says now, and the tool (6,) that its tool pose is of: metres and axis-angle.

        Only for an arm at rest. Not `getActualToolFlangePose`: ur_rtde does not wait for its answer and gives the one
        before. Raises RobotLostError.
        """
        for _ in range(3):
            before = self._reading()
            tool = self._control.getTCPOffset()
            if len(tool) != 6:
                raise RobotLostError("the robot did not tell the offset of its tool")
            after = self._reading()
            # A tool that somebody changes just now does not slip in between.
            if same_pose(before.base_tcp, after.base_tcp):
                return after, tuple(tool)
        raise RobotLostError("the robot's tool pose changes while the arm is at rest: leave the tool's settings alone")

    def alive(self) -> None:
        """The parent is there: between moves this is all it has to say."""

    def idle(self, quiet_s: float) -> None:
        """Between moves: keeps the watchdog quiet for as long as the parent lives, so that pauses end no program."""
        reading = self._reading()
        if not self._moving and quiet_s < self._lease_s:
            self._kick(reading)

    @_told_when_lost
    def end_program(self) -> bool:
        """Ends the control script, and with it any motion; whether it has ended."""
        self._stopped = True
        self._control.stopScript()
        return not self._control.isProgramRunning()

    def close(self) -> None:
        """Nothing to be done: the process is ended."""

    def _kick(self, reading: Reading) -> None:
        now_s = time.monotonic()
        if not self._stopped and reading.program == "playing" and now_s - self._last_kick_s >= 0.5 * self.IDLE_S:
            self._last_kick_s = now_s
            self._control.kickWatchdog()

    def _reading(self) -> Reading:
        receive = self._receive
        operation = self._control.getAsyncOperationProgressEx()
        clock_s, now_s = receive.getTimestamp(), time.monotonic()
        if clock_s != self._clock_s:
            self._clock_s, self._clock_moved_s = clock_s, now_s
        return Reading(
            q_rad=tuple(receive.getActualQ()),
            qd_rad_s=tuple(receive.getActualQd()),
            base_tcp=tuple(receive.getActualTCPPose()),
            controller_s=clock_s,
            age_s=now_s - self._clock_moved_s,
            connected=receive.isConnected() and self._control.isConnected(),
            robot_mode=ROBOT_MODES.get(receive.getRobotMode(), "no_controller"),
            safety_mode=safety(receive.getSafetyMode(), receive.getSafetyStatusBits()),
            program=PROGRAMS.get(receive.getRuntimeState(), "stopped"),
            operation=operation.operationId(),
            operating=operation.isAsyncOperationRunning(),
            speed_fraction=receive.getTargetSpeedFraction(),
        )


def same_pose(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Whether two tool poses (6,), metres and axis-angle, are those of one arm at rest."""
    # Near half a turn, as of a tool that points straight down, noise swaps the axis for the opposite one.
    turn = math.hypot(*b[3:])
    opposite = [each * (1.0 - 2.0 * math.pi / turn) if turn > 0 else each for each in b[3:]]
    return any(
        max(abs(x - y) for x, y in zip(a, (*b[:3], *turned), strict=True)) < SAME_POSE for turned in (b[3:], opposite)
    )


def _not_connected(address: str, why: str) -> CellError:
    """ur_rtde tells its reasons only in words."""
    if "already in use" in why:
        return RobotNotReadyError(
            "something else writes the robot's RTDE registers: end the other RTDE program, or disable EtherNet/IP, "
            "PROFINET and MODBUS in the robot's installation"
        )
    if "remote control" in why:
        return RobotNotReadyError("the robot is in local mode: switch it to remote control at its pendant")
    if "start control script" in why:
        return RobotNotReadyError("the robot did not start the control program: see the pendant's log")
    return RobotUnreachableError(
        f"connecting to the robot at {address} failed ({why}): try again, then restart the robot"
    )
