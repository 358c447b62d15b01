"""Connection to one UR controller: the driver's child process, its data, and the end of motion and program.

What ends a motion when something breaks:

- If this process hangs or dies, the controller's watchdog does. Only the polls of this process keep it alive in a move.
- If the child hangs or dies, or the link is lost, the child is killed and the program is ended over the dashboard. The
  watchdog ends it too.
- After `stop`, the child does, or the dashboard if the child does not answer at once.

A program that another client has started instead of ours is recognised at rest, and is left alone.

Between moves the child keeps the watchdog alive, so that a busy parent does no harm, but only as long as the parent
calls every few seconds. A parent that was suspended finds the program ended and does not continue. Nothing here
connects again, unlocks the robot, or sends a move twice on its own.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from calibration.geometry.transforms import from_rotation_vector
from cell.arm.arm_state import STEADY_RAD_S, arm_state, lost_connection_error, max_joint_speed
from cell.arm.control_program import DASHBOARD_S, ControlProgram
from cell.arm.driver import ArmDriver
from cell.arm.robot_modes import mode_error
from cell.arm.rtde_driver import CONNECT_S, UrDriver
from cell.arm.rtde_state import RtdeState
from cell.config.arm_config import ArmSettings
from cell.devices import ArmState
from cell.errors import (
    STOPPED,
    CellError,
    ProtectiveStopError,
    RobotLostError,
    RobotNotReadyError,
    RobotUnreachableError,
    StoppedError,
)
from cell.process.child import Child, ChildBusyError, ChildLostError, NotCalledError

log = logging.getLogger(__name__)

POLL_S = 0.01
"""Period of the polls of a moving arm."""
ANSWER_S = 0.4
"""Timeout of a call. A child that does not answer in time hangs."""
STOP_TURN_S, STOP_ANSWER_S = 0.012, 0.025
"""Times that a stop waits for its turn, and for the answer of the child, before it uses the dashboard."""
REASON_S = 0.06
"""Time to wait for the reason of a program's end. The safety mode may arrive a little later."""
STILL_S = 1.0
"""Margin on the time that the arm needs to decelerate after a stop."""
BEAT_S = 1.0
"""Period at which the child receives that this process is alive."""

LATE = 0.75
"""Share of the watchdog's time from which a silence of this computer is named as the reason for its end. A sign of life
is due after a quarter of it."""

NOT_CONNECTED = "the robot is not connected: connect first"


class ArmConnection:
    """The connection of one arm.

    All methods but `stop` belong to one thread at a time. `stop` and `latest` may be used from any thread.
    """

    def __init__(self, settings: ArmSettings, make_driver: Callable[[str, float], ArmDriver] = UrDriver) -> None:
        self._settings, self._make_driver = settings, make_driver
        self.latest: ArmState | None = None
        """Last state that the arm reported, or None."""
        self.stopped = threading.Event()
        """Set by `stop`. Nothing moves until the connection is opened again."""
        self.child: Child | None = None
        """Process of the driver, or None."""
        self.program: ControlProgram | None = None
        """Program that was last started on the controller."""
        self.move_sent = False
        """Whether a move was sent and is not known to have ended. Whatever moves the arm must then be stopped."""
        self.protective_s: float | None = None
        """Time at which a protective stop was first noticed, seconds of `time.monotonic()`, or None."""
        self._ended: CellError | None = RobotNotReadyError(NOT_CONNECTED)
        """Why nothing can be moved until the connection is opened again."""
        self._closing = threading.Event()
        self._beat: threading.Thread | None = None
        self._T_flange_tcp = np.eye(4)

    def open(self, address: str) -> ArmState:
        """Start the child, which connects, and return the first state of the arm.

        The controller must have been probed, and an earlier connection released.

        Raises:
            RobotUnreachableError: The connection takes too long.
            RobotNotReadyError: The controller rejects the connection.
            RobotLostError: The link broke.
            StoppedError: `stop` was called meanwhile.
        """
        # in this order, so that a stop that finds the child also finds the program
        self.program = ControlProgram(address, self._settings.watchdog_hz)
        self.child = child = Child("arm", self._make_driver, address, self._settings.watchdog_hz)
        try:
            try:
                state = self.update_state(*child.call("at_rest", timeout_s=CONNECT_S + 1.0))
            finally:
                self.program.there = True  # an earlier stop has not ended this program
        except (ChildLostError, CellError) as error:
            if self.stopped.is_set():
                self.fail(StoppedError(STOPPED))
            if isinstance(error, CellError):
                self.fail(error)
            self.fail(
                RobotUnreachableError(
                    f"connecting to the robot at {address} did not end ({error}): try again, then restart it"
                )
            )
        self.program.mark_started()
        self._ended, self.protective_s = None, None
        self._closing = threading.Event()
        self._beat = threading.Thread(target=_beat, args=(child, self._closing), name="arm-beat", daemon=True)
        self._beat.start()
        return state

    def call(self, method: str, *arguments: Any, unless_stopped: bool = False) -> Any:
        """Call a method of the driver and return its result. Without an answer, find the reason and end the connection.

        Args:
            method: Name of the method.
            *arguments: Arguments of the method.
            unless_stopped: Whether the call is omitted after `stop`, also if the stop still waits for its turn.
        """
        child = self.child
        if child is None:
            raise self.end_reason()
        try:
            return child.call(method, *arguments, timeout_s=ANSWER_S, unless=self.stopped if unless_stopped else None)
        except NotCalledError:
            self._end_stopped()
        except ChildLostError as error:
            if self.stopped.is_set():
                self.fail(StoppedError(STOPPED))
            self._fail_lost(
                RobotLostError(
                    f"the link to the robot was lost ({error}): end other work on this computer if it is busy, check "
                    "network and robot, then connect again"
                ),
                silent=True,
            )
        except StoppedError:
            raise
        except CellError as error:
            if method != "poll":
                self.poll_checked()  # the reason of the controller is more useful
            self._fail_lost(error)

    def poll(self) -> RtdeState:
        """Return what the controller reports, whether good or bad. Raise RobotLostError if the link broke."""
        reading: RtdeState = self.call("poll")
        self.update_state(reading)
        return reading

    def poll_checked(self) -> RtdeState:
        """Return what the controller reports if the arm can be moved. Anything else ends the connection and the motion.

        Raises:
            StoppedError: `stop` was called.
            RobotLostError: The link broke, or the program has ended.
            ProtectiveStopError: The robot is in a protective stop.
            EmergencyStopError: An emergency stop is pressed.
            RobotNotReadyError: The robot cannot be moved for another reason.
        """
        if self.stopped.is_set():
            self._end_stopped()
        reading = self.poll()
        error = self._find_fault(reading)
        if error is not None:
            self.fail(error)
        return reading

    def require_ready(self) -> RtdeState:
        """Return `poll_checked`, but raise at once if the connection has ended."""
        if self._ended is not None or self.stopped.is_set():
            raise self.end_reason()
        return self.poll_checked()

    def at_rest(self) -> ArmState:
        """Return the state of an arm at rest, for which the tool on the flange is queried again."""
        return self.update_state(*self.call("at_rest"))

    def update_state(self, reading: RtdeState, flange_tool: tuple[float, ...] | None = None) -> ArmState:
        """Convert a reading to a state and keep it in `latest`.

        Args:
            reading: What the controller reports.
            flange_tool: Tool pose (6,) on the flange, metres and radians. None means the last known one.
        """
        if flange_tool is not None:
            self._T_flange_tcp = from_rotation_vector(flange_tool[:3], flange_tool[3:])
        self.latest = arm_state(reading, self._T_flange_tcp, self.stopped.is_set())
        return self.latest

    def stop(self) -> None:
        """Stop the arm. It may be called from any thread."""
        self.stopped.set()
        child = self.child
        if child is not None:
            deceleration = self._settings.stop_deceleration_m_s2
            try:
                child.call("stop", deceleration, timeout_s=STOP_ANSWER_S, turn_s=STOP_TURN_S)
                return
            except (ChildLostError, ChildBusyError, CellError) as error:
                log.warning("stopping over the dashboard: %s", error)
                # first, because the child may be about to send a move
                child.kill()
            except BaseException:
                child.kill()  # interrupted: without the child, the watchdog ends the motion
                raise
        self._end_program(DASHBOARD_S, including_foreign=True)

    def fail(self, error: CellError) -> NoReturn:
        """End connection, program and motion, and raise the error, now and at every later move."""
        self._ended = error
        if isinstance(error, ProtectiveStopError) and self.protective_s is None:
            self.protective_s = time.monotonic()
        self._closing.set()
        child, self.child = self.child, None
        if child is not None:
            child.kill()
        self._end_program(POLL_S, including_foreign=self.move_sent)
        if child is not None:
            child.close()
        raise self.end_reason()

    def _fail_lost(self, error: CellError, silent: bool = False) -> NoReturn:
        """Call `fail`, for a resting arm with the reason that the dashboard gives.

        When the program of another client has taken the arm, ur_rtde waits for seconds, and the `silent` child with it.
        """
        if not self.move_sent and self.program is not None:
            state, name = self.program.update_state()
            if name is not None:
                error = RobotNotReadyError(
                    f"another program ({name or 'without a name'}) was started on the robot: stop it at the pendant, "
                    "then connect again"
                )
            elif silent and state == "STOPPED":
                log.warning("%s", error)
                error = self._program_ended("stopped")
        self.fail(error)

    def end_reason(self) -> CellError:
        """Return why nothing can be moved."""
        if self._ended is None:
            return StoppedError(STOPPED)
        return type(self._ended)(str(self._ended))

    def release(self) -> None:
        """End the child and the program, so that the connection can be opened again. The arm does not move."""
        self._closing.set()
        child, self.child = self.child, None
        if child is not None:
            try:
                if child.call("end_program", timeout_s=ANSWER_S, turn_s=ANSWER_S) and self.program is not None:
                    self.program.there = False
            except (ChildLostError, ChildBusyError, CellError) as error:
                log.info("ending the program over the dashboard: %s", error)
            child.close()
        self._end_program(DASHBOARD_S, including_foreign=False)
        if self.program is not None:
            self.program.wait()
        self.move_sent = False
        if self._beat is not None:
            self._beat.join()
            self._beat = None
        self._ended = RobotNotReadyError(NOT_CONNECTED)

    def _find_fault(self, reading: RtdeState) -> CellError | None:
        """Return why the arm must not or cannot continue, or None."""
        limit_s = time.monotonic() + REASON_S
        while True:
            error = lost_connection_error(reading) or mode_error(reading.robot_mode, reading.safety_mode)
            if error is not None or reading.program == "playing":
                return error
            if time.monotonic() > limit_s:
                return self._program_ended(reading.program, reading.silent_s, reading.still_s)
            time.sleep(POLL_S)
            reading = self.poll()

    def _program_ended(self, program: str, silent_s: float = 0.0, still_s: float = 0.0) -> RobotLostError:
        """Return the error. It names who was late, so that nobody looks at the network.

        Args:
            program: State of the program.
            silent_s: As in the reading.
            still_s: As in the reading. If the driver's process stood still too, the whole computer was late.
        """
        watchdog_s = 1.0 / self._settings.watchdog_hz
        ended = f"the robot's control program is {program}: its watchdog received nothing for {watchdog_s:g} s"
        if silent_s < LATE * watchdog_s:
            return RobotLostError(f"{ended}, or a person ended it at the pendant. Connect again")
        if still_s >= LATE * watchdog_s:
            why = f"this computer stood still for {still_s:.1f} s"
        else:
            why = f"this service stood still for at least {silent_s:.1f} s"
        return RobotLostError(
            f"{ended}, because {why}. The network is not the cause: end other work on this computer, then connect again"
        )

    def _end_stopped(self) -> NoReturn:
        """Wait, in the thread that moved the arm, until it stands still. Then raise StoppedError."""
        reading = self.poll()
        limit_s = time.monotonic() + self._settings.flange_speed_m_s / self._settings.stop_deceleration_m_s2 + STILL_S
        while max_joint_speed(reading) > STEADY_RAD_S:
            if time.monotonic() > limit_s or lost_connection_error(reading) is not None:
                self.fail(
                    RobotLostError("the robot was stopped, but it is unknown whether it stands still: inspect it")
                )
            time.sleep(POLL_S)
            reading = self.poll()
        # A stop must not hide a fault. A paused program must not continue either, because no watchdog would end it.
        error = self._find_fault(reading)
        if error is not None:
            self.fail(StoppedError(STOPPED) if isinstance(error, RobotLostError) else error)
        self.move_sent = False
        raise self.end_reason()

    def _end_program(self, wait_s: float, including_foreign: bool) -> None:
        program = self.program
        if program is not None:
            program.abandon()
            program.end(wait_s, including_foreign)


def _beat(child: Child, closing: threading.Event) -> None:
    while not closing.wait(BEAT_S):
        try:
            child.call("alive", timeout_s=ANSWER_S, turn_s=0.0)
        except ChildBusyError:
            continue  # the call that has the turn shows the same
        except ChildLostError:
            return  # the next command reports the error
