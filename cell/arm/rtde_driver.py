"""Driver of a UR controller through ur_rtde. It runs in a child process, see `cell.process.child`.

Every call is short: it reads, or passes one command to the control script that ur_rtde runs on the controller. Moves
are asynchronous, and the parent's polls monitor them. The driver allows for these properties of ur_rtde 1.6.5:

- Its constructors hold the interpreter's lock and may hang. An alarm of the kernel then ends the process.
- On a lost link it reconnects by itself, uploads its script and sends its last command again. Once connected, this
  process may therefore open no file or socket, so that a lost link ends it.
- It does not notice a dead link. Readings contain the age of the controller's clock.
- `stopJ(..., asynchronous=True)` is accepted during a move. The script then decelerates the tool (stopl).
- Its objects take half a second each to close. The process is ended instead.
"""

from __future__ import annotations

import functools
import math
import resource
import signal
import time
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from cell.arm.rtde_state import PROGRAMS, ROBOT_MODES, RtdeState, decode_safety_mode
from cell.errors import STOPPED, CellError, RobotLostError, RobotNotReadyError, RobotUnreachableError, StoppedError

CONNECT_S = 6.0
"""Timeout for connecting. The script alone may take 5 s to start."""
CONTROL_HZ = 250.0
"""Rate of the commands: half of the maximum, which halves the load and gives a period of 4 ms."""
READ_HZ = 125.0
"""Rate of the controller's data."""
LEASE_S = 5.0
"""Time after the parent's last call during which the watchdog of a resting arm is kept alive."""
SILENCE_S = 2.0
"""Time for which the longest silence is kept. The end of a program is seen earlier."""
SAME_POSE = 1e-3
"""Largest difference of TCP poses of an arm at rest, metres and radians."""

_OPEN_FILES = 3
_VARIABLES = [
    "timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "robot_mode", "safety_mode", "safety_status_bits",
    "runtime_state", "target_speed_fraction",
]  # fmt: skip

P = ParamSpec("P")
R = TypeVar("R")


def _raises_when_lost(
    method: Callable[Concatenate[UrDriver, P], R],
) -> Callable[Concatenate[UrDriver, P], R]:
    """Turn the RuntimeError that ur_rtde raises for a broken connection into RobotLostError."""

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
    """A `cell.arm.driver.ArmDriver`: one connection to one controller, in a child process."""

    def __init__(
        self, address: str, watchdog_hz: float, connect_s: float = CONNECT_S, lease_s: float = LEASE_S
    ) -> None:
        """Connect, upload the control script and start its watchdog. A running program is ended, so probe first.

        Args:
            address: IP address of the controller.
            watchdog_hz: Frequency of the watchdog.
            connect_s: Timeout for connecting.
            lease_s: Time after the parent's last call during which the watchdog of a resting arm is kept alive.

        Raises:
            RobotUnreachableError: The controller does not answer.
            RobotNotReadyError: The controller rejects the connection or the watchdog.
        """
        from rtde_control import RTDEControlInterface as Control
        from rtde_receive import RTDEReceiveInterface as Receive

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.setitimer(signal.ITIMER_REAL, connect_s)
        try:
            self._receive = Receive(address, READ_HZ, _VARIABLES)
            # without the flag the script would also claim the input of an external force sensor
            self._control = Control(address, CONTROL_HZ, Control.FLAG_UPLOAD_SCRIPT | Control.FLAG_NO_EXT_FT)
        except RuntimeError as error:
            raise _not_connected(address, str(error)) from error
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, _OPEN_FILES))
        self.IDLE_S = 0.25 / watchdog_hz
        self._lease_s = lease_s
        self._moving = False
        self._stopped = False
        self._silence, self._stillness = Silence(time.monotonic()), Silence(time.monotonic())
        self._clock_s, self._clock_moved_s = -1.0, time.monotonic()
        if not self._control.setWatchdog(watchdog_hz):
            raise RobotNotReadyError("the robot did not accept the watchdog's frequency: connect again")

    @_raises_when_lost
    def poll(self) -> RtdeState:
        """Return what the controller reports now, and keep the watchdog alive."""
        reading = self._reading()
        if self._moving and not reading.operating and reading.operation != self._operation_before:
            self._moving = False
        self._kick(reading)
        return reading

    @_raises_when_lost
    def allows(self, q_rad: tuple[float, ...]) -> bool:
        """Return whether the joint angles (6,) are within the safety limits of the controller."""
        return self._control.isJointsWithinSafetyLimits(list(q_rad))

    @_raises_when_lost
    def start_move(self, q_rad: tuple[float, ...], speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Start a joint move and return the number of the previous operation, as `ArmDriver.start_move` says."""
        if self._stopped:
            raise StoppedError(STOPPED)
        self._operation_before = self._control.getAsyncOperationProgressEx().operationId()
        self._moving = True
        if not self._control.moveJ(list(q_rad), speed_rad_s, acceleration_rad_s2, True):
            raise RobotNotReadyError("the robot did not accept the move")
        return self._operation_before

    @_raises_when_lost
    def stop(self, deceleration_m_s2: float) -> None:
        """Stop the arm, and send no move afterwards."""
        self._stopped = True
        # the asynchronous form, which a running move needs, becomes a stopl: the deceleration is that of the tool
        self._control.stopJ(deceleration_m_s2, True)

    @_raises_when_lost
    def at_rest(self) -> tuple[RtdeState, tuple[float, ...]]:
        """Return what the controller reports of an arm at rest, and the tool's pose (6,) on the flange.

        `getActualToolFlangePose` is not used: ur_rtde does not wait for its answer and returns the previous one.
        """
        for _ in range(3):
            before = self._reading()
            tool = self._control.getTCPOffset()
            if len(tool) != 6:
                raise RobotLostError("the robot did not report the offset of its tool")
            after = self._reading()
            # the tool may be changed between two readings
            if same_pose(before.base_tcp, after.base_tcp):
                return after, tuple(tool)
        raise RobotLostError(
            "the robot's tool pose changes while the arm is at rest: do not change the tool's settings meanwhile"
        )

    def alive(self) -> None:
        """Receive that the parent process is alive."""

    def idle(self, quiet_s: float) -> None:
        """Keep the watchdog of a resting arm alive as long as the parent is alive, so that pauses end no program."""
        reading = self._reading()
        if not self._moving and quiet_s < self._lease_s:
            self._kick(reading)

    @_raises_when_lost
    def end_program(self) -> bool:
        """End the control script, and with it any motion. Return whether it has ended."""
        self._stopped = True
        self._control.stopScript()
        return not self._control.isProgramRunning()

    def close(self) -> None:
        """Do nothing: the process is ended."""

    def _kick(self, reading: RtdeState) -> None:
        now_s = time.monotonic()
        if not self._stopped and reading.program == "playing" and now_s - self._silence.since_s >= 0.5 * self.IDLE_S:
            self._silence.end(now_s)
            self._control.kickWatchdog()

    def _reading(self) -> RtdeState:
        receive = self._receive
        operation = self._control.getAsyncOperationProgressEx()
        clock_s, now_s = receive.getTimestamp(), time.monotonic()
        if clock_s != self._clock_s:
            self._clock_s, self._clock_moved_s = clock_s, now_s
        self._stillness.end(now_s)
        program = PROGRAMS.get(receive.getRuntimeState(), "stopped")
        return RtdeState(
            q_rad=tuple(receive.getActualQ()),
            qd_rad_s=tuple(receive.getActualQd()),
            base_tcp=tuple(receive.getActualTCPPose()),
            controller_s=clock_s,
            age_s=now_s - self._clock_moved_s,
            connected=receive.isConnected() and self._control.isConnected(),
            robot_mode=ROBOT_MODES.get(receive.getRobotMode(), "no_controller"),
            safety_mode=decode_safety_mode(receive.getSafetyMode(), receive.getSafetyStatusBits()),
            program=program,
            operation=operation.operationId(),
            operating=operation.isAsyncOperationRunning(),
            speed_fraction=receive.getTargetSpeedFraction(),
            silent_s=self._silence.longest(now_s, program == "playing"),
            still_s=self._stillness.longest(now_s, True),
        )


class Silence:
    """The longest time without a sign of life, which distinguishes a late computer from a broken link."""

    def __init__(self, now_s: float) -> None:
        """Begin at `now_s`, seconds of `time.monotonic()`, as all times here."""
        self.since_s = now_s
        """Time of the last sign of life."""
        self._longest_s, self._longest_at_s = 0.0, now_s
        self._ended_s: float | None = None
        """Time at which the program was first seen to have ended, or None. Nothing is sent to the watchdog then."""

    def end(self, now_s: float) -> None:
        """Note a sign of life, which ends a silence."""
        self._note(now_s)
        self.since_s = now_s

    def longest(self, now_s: float, playing: bool) -> float:
        """Return the longest time of the last `SILENCE_S`, seconds.

        Args:
            now_s: Present time.
            playing: Whether the program runs.
        """
        self._ended_s = None if playing else self._ended_s or now_s
        self._note(self._ended_s or now_s)
        return self._longest_s

    def _note(self, now_s: float) -> None:
        silent_s = now_s - self.since_s
        if silent_s >= self._longest_s or now_s > self._longest_at_s + SILENCE_S:
            self._longest_s, self._longest_at_s = silent_s, now_s


def same_pose(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Return whether two TCP poses (6,), metres and rotation vector, are those of one arm at rest."""
    # near half a turn, as for a tool that points down, noise flips the rotation vector
    turn = math.hypot(*b[3:])
    opposite = [each * (1.0 - 2.0 * math.pi / turn) if turn > 0 else each for each in b[3:]]
    return any(
        max(abs(x - y) for x, y in zip(a, (*b[:3], *turned), strict=True)) < SAME_POSE for turned in (b[3:], opposite)
    )


def _not_connected(address: str, why: str) -> CellError:
    """Return the error for a message of ur_rtde, which has no error codes."""
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
