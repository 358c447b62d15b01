"""The link to one UR controller: the child process that drives it, what it says, and how everything is ended.

Who ends a motion when something breaks:

- this process hangs or dies: the controller's watchdog, which only this process's polls keep quiet during a move;
- the child hangs or dies: it is killed, and the program ended over the dashboard; else the watchdog as well;
- the link is lost: the same;
- somebody calls `stop`: the child, or the dashboard when it does not answer at once.

At rest a program that somebody else has started in place of ours is told apart, and left to them.

Between moves the child keeps the watchdog quiet, which costs next to nothing and does not mind a busy parent, but only
as long as the parent is heard every few seconds: one that was suspended finds the program ended, and does not go on
from where it was. Nothing here ever connects again, unlocks, or sends a move a second time by itself.
"""

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from calibration.geometry.transforms import from_rotation_vector
from cell.arm.arm_reading import STEADY_RAD_S, arm_state, fastest, silence
from cell.arm.control_program import DASHBOARD_S, OurProgram
from cell.arm.driver import ArmDriver
from cell.arm.robot_modes import mode_error
from cell.arm.rtde_driver import CONNECT_S, UrDriver
from cell.arm.ur_reading import Reading
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
"""Between two looks at a moving arm."""
ANSWER_S = 0.4
"""A child that does not answer a call for so long hangs."""
STOP_TURN_S, STOP_ANSWER_S = 0.012, 0.025
"""A stop waits so long for its turn, and for the child's answer, before it takes the dashboard's way."""
REASON_S = 0.06
"""A program that ends is waited for so long to tell why: the safety system's word may come a little later."""
STILL_S = 1.0
"""After a stop the arm is still so long after it must be, by its deceleration, at the latest."""
BEAT_S = 1.0
"""How often the child is told that this process lives."""

NOT_CONNECTED = "the robot is not connected: connect first"


class ArmLink:
    """All methods but `stop` belong to one thread at a time; `stop` and `latest` to any."""

    def __init__(self, settings: ArmSettings, make_driver: Callable[[str, float], ArmDriver] = UrDriver) -> None:
        self._settings, self._make_driver = settings, make_driver
        self.latest: ArmState | None = None
        """What the arm last told of itself."""
        self.stopped = threading.Event()
        """Set by `stop`; then nothing moves until the link is opened again."""
        self.child: Child | None = None
        self.program: OurProgram | None = None
        """What was last put on the controller."""
        self.move_sent = False
        """A move was sent, and not seen to end: now whatever moves the arm must be stopped."""
        self.protective_s: float | None = None
        """When a protective stop was first seen, `time.monotonic()`."""
        self._ended: CellError | None = RobotNotReadyError(NOT_CONNECTED)
        """Why nothing can be moved until the link is opened again."""
        self._closing = threading.Event()
        self._beat: threading.Thread | None = None
        self._T_flange_tcp = np.eye(4)

    def open(self, address: str) -> ArmState:
        """Starts the child, which connects: a controller that was probed, after `release`. The arm's first state.

        Raises: RobotUnreachableError, RobotNotReadyError, RobotLostError; StoppedError after a `stop` meanwhile.
        """
        # In this order: a stop that finds the child finds what it is to end as well.
        self.program = OurProgram(address, self._settings.watchdog_hz)
        self.child = child = Child("arm", self._make_driver, address, self._settings.watchdog_hz)
        try:
            try:
                state = self.seen(*child.call("at_rest", timeout_s=CONNECT_S + 1.0))
            finally:
                self.program.there = True  # a stop that came before it has not ended it
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
        self.program.started()
        self._ended, self.protective_s = None, None
        self._closing = threading.Event()
        self._beat = threading.Thread(target=_beat, args=(child, self._closing), name="arm-beat", daemon=True)
        self._beat.start()
        return state

    def call(self, method: str, *arguments: Any, unless_stopped: bool = False) -> Any:
        """What the driver answers; when it does not, the reason is looked for, and the link ended.

        `unless_stopped`: once `stop` was called it is not sent, also when a stop still waits for its own turn.
        """
        child = self.child
        if child is None:
            raise self.why_ended()
        try:
            return child.call(method, *arguments, timeout_s=ANSWER_S, unless=self.stopped if unless_stopped else None)
        except NotCalledError:
            self._end_stopped()
        except ChildLostError as error:
            if self.stopped.is_set():
                self.fail(StoppedError(STOPPED))
            self._fail_lost(
                RobotLostError(
                    f"the link to the robot was lost ({error}): check network and robot, then connect again"
                ),
                silent=True,
            )
        except StoppedError:
            raise
        except CellError as error:
            if method != "poll":
                self.good_poll()  # the reason why the controller did not do it is worth more
            self._fail_lost(error)

    def poll(self) -> Reading:
        """What the controller says, be it good or bad. Raises RobotLostError."""
        reading: Reading = self.call("poll")
        self.seen(reading)
        return reading

    def good_poll(self) -> Reading:
        """What the controller says if all is well with it; anything else ends the link, and the motion with it.

        Raises: StoppedError, RobotLostError, ProtectiveStopError, EmergencyStopError, RobotNotReadyError.
        """
        if self.stopped.is_set():
            self._end_stopped()
        reading = self.poll()
        error = self._fault(reading)
        if error is not None:
            self.fail(error)
        return reading

    def ready(self) -> Reading:
        """Like `good_poll`, and raises at once when the link has ended."""
        if self._ended is not None or self.stopped.is_set():
            raise self.why_ended()
        return self.good_poll()

    def at_rest(self) -> ArmState:
        """The state of an arm at rest, with the tool asked for anew that is taken off its flange."""
        return self.seen(*self.call("at_rest"))

    def seen(self, reading: Reading, flange_tool: tuple[float, ...] | None = None) -> ArmState:
        """The reading as a state, kept in `latest`. The tool at the flange is the last one known unless given."""
        if flange_tool is not None:
            self._T_flange_tcp = from_rotation_vector(flange_tool[:3], flange_tool[3:])
        self.latest = arm_state(reading, self._T_flange_tcp, self.stopped.is_set())
        return self.latest

    def stop(self) -> None:
        """Stops the arm at once; from any thread."""
        self.stopped.set()
        child = self.child
        if child is not None:
            deceleration = self._settings.stop_deceleration_m_s2
            try:
                child.call("stop", deceleration, timeout_s=STOP_ANSWER_S, turn_s=STOP_TURN_S)
                return
            except (ChildLostError, ChildBusyError, CellError) as error:
                log.warning("stopping over the dashboard: %s", error)
                # First of all it must not be able to send the move that it is perhaps just about to send.
                child.kill()
            except BaseException:
                child.kill()  # interrupted: without it the watchdog, or whoever moves the arm, ends the motion
                raise
        self._end_program(DASHBOARD_S, whatever_plays=True)

    def fail(self, error: CellError) -> NoReturn:
        """Ends link, program and motion, and raises the error, now and whenever a move is asked for."""
        self._ended = error
        if isinstance(error, ProtectiveStopError) and self.protective_s is None:
            self.protective_s = time.monotonic()
        self._closing.set()
        child, self.child = self.child, None
        if child is not None:
            child.kill()
        self._end_program(POLL_S, whatever_plays=self.move_sent)
        if child is not None:
            child.close()
        raise self.why_ended()

    def _fail_lost(self, error: CellError, silent: bool = False) -> NoReturn:
        """`fail`; for an arm at rest with what the controller says of its program, where that tells more. ur_rtde, and
        the `silent` child with it, waits for seconds when somebody else's program has taken the arm, also if that has
        ended by now."""
        if not self.move_sent and self.program is not None:
            state, name = self.program.seen()
            if name is not None:
                error = RobotNotReadyError(
                    f"another program ({name or 'without a name'}) was started on the robot: stop it at the pendant, "
                    "then connect again"
                )
            elif silent and state == "STOPPED":
                log.warning("%s", error)
                error = self._program_ended("stopped")
        self.fail(error)

    def why_ended(self) -> CellError:
        """Why nothing can be moved."""
        if self._ended is None:
            return StoppedError(STOPPED)
        return type(self._ended)(str(self._ended))

    def release(self) -> None:
        """Ends what is left, the program included; nothing moves. Afterwards the link can be opened again."""
        self._closing.set()
        child, self.child = self.child, None
        if child is not None:
            try:
                if child.call("end_program", timeout_s=ANSWER_S, turn_s=ANSWER_S) and self.program is not None:
                    self.program.there = False
            except (ChildLostError, ChildBusyError, CellError) as error:
                log.info("ending the program over the dashboard: %s", error)
            child.close()
        self._end_program(DASHBOARD_S, whatever_plays=False)
        if self.program is not None:
            self.program.wait()
        self.move_sent = False
        if self._beat is not None:
            self._beat.join()
            self._beat = None
        self._ended = RobotNotReadyError(NOT_CONNECTED)

    def _fault(self, reading: Reading) -> CellError | None:
        """Why the arm must not, or cannot, go on; None if all is well."""
        limit_s = time.monotonic() + REASON_S
        while True:
            error = silence(reading) or mode_error(reading.robot_mode, reading.safety_mode)
            if error is not None or reading.program == "playing":
                return error
            if time.monotonic() > limit_s:
                return self._program_ended(reading.program)
            time.sleep(POLL_S)
            reading = self.poll()

    def _program_ended(self, program: str) -> RobotLostError:
        return RobotLostError(
            f"the robot's control program is {program}: its watchdog heard nothing from here for "
            f"{1.0 / self._settings.watchdog_hz:g} s, or somebody ended it at the pendant. Connect again"
        )

    def _end_stopped(self) -> NoReturn:
        """After `stop`, by the thread that moved: until the arm is still. It is made to be when that takes too long."""
        reading = self.poll()
        limit_s = time.monotonic() + self._settings.flange_speed_m_s / self._settings.stop_deceleration_m_s2 + STILL_S
        while fastest(reading) > STEADY_RAD_S:
            if time.monotonic() > limit_s or silence(reading) is not None:
                self.fail(RobotLostError("the robot was told to stop, and it is not known whether it did: look at it"))
            time.sleep(POLL_S)
            reading = self.poll()
        # A stop hides no fault that came with it: somebody must look. And what has only paused the program, whether it
        # is known or not, must not let it be played on: no watchdog ends it then.
        error = self._fault(reading)
        if error is not None:
            self.fail(StoppedError(STOPPED) if isinstance(error, RobotLostError) else error)
        self.move_sent = False
        raise self.why_ended()

    def _end_program(self, wait_s: float, whatever_plays: bool) -> None:
        program = self.program
        if program is not None:
            program.left_alone()
            program.end(wait_s, whatever_plays)


def _beat(child: Child, closing: threading.Event) -> None:
    while not closing.wait(BEAT_S):
        try:
            child.call("alive", timeout_s=ANSWER_S, turn_s=0.0)
        except ChildBusyError:
            continue  # whoever has the turn is heard as well
        except ChildLostError:
            return  # the next one who wants something of the arm is told
