"""The control program that a child process has put on a controller, and its end over the dashboard.

Needs neither that process nor its connection, and so also ends what they cannot end any more. A program that somebody
else has started in place of ours is left alone, unless the arm must be stopped whatever moves it.
"""

import contextlib
import logging
import threading
import time

from cell.arm.dashboard import Dashboard, no_program_left, stop_program
from cell.errors import RobotUnreachableError

log = logging.getLogger(__name__)

DASHBOARD_S = 1.0
"""Longest that ending the program over the dashboard may take."""
ASK_S = 0.3
"""Longest that asking which program is there may take."""
STARVED_S = 1.0
"""So long after its watchdog must have ended our program, one that plays is somebody else's."""


class OurProgram:
    """One program on one controller. `end` may be called from any thread."""

    def __init__(self, address: str, watchdog_hz: float) -> None:
        """Of a controller on which no program was, and on which ours is now about to be started."""
        self.address = address
        self.there = True
        """It may be on the controller."""
        self._watchdog_s = 1.0 / watchdog_hz
        self._name: str | None = None
        self._alone_s: float | None = None
        self._endings: list[threading.Thread] = []

    def started(self) -> None:
        """It runs and its watchdog is armed. Asks under which name, by which another one is known later."""
        with contextlib.suppress(RobotUnreachableError):
            state, name = _program_on(self.address)
            self._name = name if state == "PLAYING" else None

    def left_alone(self) -> None:
        """Nobody keeps its watchdog quiet from now on."""
        self._alone_s = self._alone_s or time.monotonic()

    def seen(self) -> tuple[str | None, str | None]:
        """What the controller says of its program, STOPPED if none runs, None if it says nothing; and the name of one
        that somebody else has started in place of ours, None if none is known of."""
        try:
            state, name = _program_on(self.address)
        except RobotUnreachableError:
            return None, None
        if self._name is None or state == "STOPPED":
            return state, None
        starved = self._alone_s is not None and time.monotonic() > self._alone_s + self._watchdog_s + STARVED_S
        return state, name if name != self._name or (starved and state == "PLAYING") else None

    def end(self, wait_s: float, whatever_plays: bool) -> None:
        """Ends it, and its motion with it. Returns after `wait_s` at the latest, while it goes on trying.

        `whatever_plays`: somebody else's program is ended too.
        """
        if not self.there:
            return
        thread = threading.Thread(target=self._end, args=(whatever_plays,), name="arm-end-program", daemon=True)
        thread.start()
        self._endings.append(thread)  # only now: another thread may join it at once
        thread.join(wait_s)

    def wait(self) -> None:
        """Until nothing more is tried: a late end would be that of the next program."""
        while self._endings:
            self._endings.pop().join()

    def _end(self, whatever_plays: bool) -> None:
        try:
            if not whatever_plays and (name := self.seen()[1]) is not None:
                log.warning("the program %s on the robot is not ours and is left alone", name)
            else:
                answer = stop_program(self.address, DASHBOARD_S)
                if not no_program_left(answer):  # and no watchdog ends one that is paused
                    log.warning("the robot did not end the program: it says %r", answer)
                    return
            self.there = False
        except RobotUnreachableError as error:
            log.warning("the program was not ended, its watchdog will do it: %s", error)


def _program_on(address: str) -> tuple[str, str]:
    """State and name of the controller's program. Raises RobotUnreachableError."""
    with Dashboard(address, time.monotonic() + ASK_S) as dashboard:
        state, _, name = dashboard.ask("programState").partition(" ")
    return state, name
