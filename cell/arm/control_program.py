"""The control program that the driver has started on a controller, and its end over the dashboard.

The dashboard needs neither the driver's process nor its connection, so a program can be ended when both have failed. A
program of another client is left alone, unless the arm must be stopped in any case.
"""

import contextlib
import logging
import threading
import time

from cell.arm.dashboard import Dashboard, no_program_left, stop_program
from cell.errors import RobotUnreachableError

log = logging.getLogger(__name__)

DASHBOARD_S = 1.0
"""Timeout for ending the program over the dashboard."""
ASK_S = 0.3
"""Timeout for querying the program over the dashboard."""
STARVED_S = 1.0
"""Time after the watchdog's end of our program, after which a running program is that of another client."""


class OurProgram:
    """Our program on one controller. `end` may be called from any thread."""

    def __init__(self, address: str, watchdog_hz: float) -> None:
        """Create the record of a program that is about to be started on a controller without a program."""
        self.address = address
        self.there = True
        """Whether the program may be on the controller."""
        self._watchdog_s = 1.0 / watchdog_hz
        self._name: str | None = None
        self._alone_s: float | None = None
        self._endings: list[threading.Thread] = []

    def started(self) -> None:
        """Record that the program runs, and query its name, by which other programs are recognised."""
        with contextlib.suppress(RobotUnreachableError):
            state, name = _program_on(self.address)
            self._name = name if state == "PLAYING" else None

    def left_alone(self) -> None:
        """Record that nothing keeps the program's watchdog alive from now on."""
        self._alone_s = self._alone_s or time.monotonic()

    def seen(self) -> tuple[str | None, str | None]:
        """Query the program on the controller.

        Returns:
            State of the program, "STOPPED" without a program, or None without an answer. Name of a program that another
            client has started instead of ours, or None.
        """
        try:
            state, name = _program_on(self.address)
        except RobotUnreachableError:
            return None, None
        if self._name is None or state == "STOPPED":
            return state, None
        starved = self._alone_s is not None and time.monotonic() > self._alone_s + self._watchdog_s + STARVED_S
        return state, name if name != self._name or (starved and state == "PLAYING") else None

    def end(self, wait_s: float, whatever_plays: bool) -> None:
        """End the program, and its motion with it.

        Args:
            wait_s: Time after which the method returns; the attempt continues in a thread.
            whatever_plays: Whether the program of another client is ended too.
        """
        if not self.there:
            return
        thread = threading.Thread(target=self._end, args=(whatever_plays,), name="arm-end-program", daemon=True)
        thread.start()
        self._endings.append(thread)  # after the start, because another thread may join it at once
        thread.join(wait_s)

    def wait(self) -> None:
        """Wait for the end of all attempts. A late attempt would end the next program."""
        while self._endings:
            self._endings.pop().join()

    def _end(self, whatever_plays: bool) -> None:
        try:
            if not whatever_plays and (name := self.seen()[1]) is not None:
                log.warning("the program %s on the robot is not ours and is left alone", name)
            else:
                answer = stop_program(self.address, DASHBOARD_S)
                if not no_program_left(answer):  # a watchdog does not end a paused program
                    log.warning("the robot did not end the program: it says %r", answer)
                    return
            self.there = False
        except RobotUnreachableError as error:
            log.warning("the program was not ended, its watchdog will do it: %s", error)


def _program_on(address: str) -> tuple[str, str]:
    """Return state and name of the controller's program. Raise RobotUnreachableError without an answer."""
    with Dashboard(address, time.monotonic() + ASK_S) as dashboard:
        state, _, name = dashboard.ask("programState").partition(" ")
    return state, name
