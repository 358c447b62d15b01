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
WATCHDOG_MARGIN_S = 1.0
"""Time after the watchdog's end of our program, after which a running program is that of another client."""


class ControlProgram:
    """Our program on one controller. `end` may be called from any thread."""

    def __init__(self, address: str, watchdog_hz: float) -> None:
        """Create the record of a program that is about to be started on a controller without a program."""
        self.address = address
        self.there = True
        """Whether the program may be on the controller."""
        self._watchdog_s = 1.0 / watchdog_hz
        self._name: str | None = None
        self._abandoned_s: float | None = None
        self._end_threads: list[threading.Thread] = []

    def mark_started(self) -> None:
        """Record that the program runs, and query its name, by which other programs are recognised."""
        with contextlib.suppress(RobotUnreachableError):
            state, name = _query_program(self.address)
            self._name = name if state == "PLAYING" else None

    def abandon(self) -> None:
        """Record that nothing keeps the program's watchdog alive from now on."""
        self._abandoned_s = self._abandoned_s or time.monotonic()

    def update_state(self) -> tuple[str | None, str | None]:
        """Query the program on the controller.

        Returns:
            State of the program, "STOPPED" without a program, or None without an answer. Name of a program that another
            client has started instead of ours, or None.
        """
        try:
            state, name = _query_program(self.address)
        except RobotUnreachableError:
            return None, None
        if self._name is None or state == "STOPPED":
            return state, None
        watchdog_expired = (
            self._abandoned_s is not None
            and time.monotonic() > self._abandoned_s + self._watchdog_s + WATCHDOG_MARGIN_S
        )
        return state, name if name != self._name or (watchdog_expired and state == "PLAYING") else None

    def end(self, wait_s: float, including_foreign: bool) -> None:
        """End the program, and its motion with it.

        Args:
            wait_s: Time after which the method returns; the attempt continues in a thread.
            including_foreign: Whether the program of another client is ended too.
        """
        if not self.there:
            return
        thread = threading.Thread(target=self._end, args=(including_foreign,), name="arm-end-program", daemon=True)
        thread.start()
        self._end_threads.append(thread)  # after the start, because another thread may join it at once
        thread.join(wait_s)

    def wait(self) -> None:
        """Wait for the end of all attempts. A late attempt would end the next program."""
        while self._end_threads:
            self._end_threads.pop().join()

    def _end(self, including_foreign: bool) -> None:
        try:
            if not including_foreign and (name := self.update_state()[1]) is not None:
                log.warning("the program %s on the robot was not started by this software and keeps running", name)
            else:
                answer = stop_program(self.address, DASHBOARD_S)
                if not no_program_left(answer):  # a watchdog does not end a paused program
                    log.warning("the robot did not end the program: it says %r", answer)
                    return
            self.there = False
        except RobotUnreachableError as error:
            log.warning("the program could not be ended; its watchdog will end it: %s", error)


def _query_program(address: str) -> tuple[str, str]:
    """Return state and name of the controller's program. Raise RobotUnreachableError without an answer."""
    with Dashboard(address, time.monotonic() + ASK_S) as dashboard:
        state, _, name = dashboard.ask("programState").partition(" ")
    return state, name
