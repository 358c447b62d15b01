"""The watchdog of the event loop. A stop request cannot get through a hung loop, so the watchdog stops the arm."""

import asyncio
import logging
import sys
import threading
import traceback
from collections.abc import Callable

log = logging.getLogger(__name__)

TICK_S = 0.1
HUNG_TICKS = 12
"""Ticks of the watchdog without one turn of the loop, after which the loop hangs.

Ticks are counted instead of time, because the watchdog stands still too if the whole machine does.
"""


class EventLoopWatchdog:
    """A thread that checks that an event loop still runs.

    The thread needs the interpreter's lock. If something holds that for ever, the service no longer reaches the arm's
    controller either, and the controller's own watchdog stops the arm.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, on_hang: Callable[[], None]) -> None:
        """Start to watch a loop. Call this in the loop's thread.

        Args:
            loop: The event loop.
            on_hang: Called once each time that the loop hangs.
        """
        self._loop, self._on_hang = loop, on_hang
        self._loop_thread = threading.get_ident()
        self._missed_ticks = 0
        self._waiting = False
        self._hung = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="loop-watch", daemon=True)
        self._thread.start()

    @property
    def is_responsive(self) -> bool:
        """Whether the loop does not hang."""
        return not self._hung

    def close(self) -> None:
        """Stop watching, and wait for the end of the thread."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(TICK_S):
            if not self._waiting:
                self._waiting = True
                try:
                    self._loop.call_soon_threadsafe(self._on_turn)
                except RuntimeError:  # the loop is closed: the service has ended
                    return
            self._missed_ticks += 1
            if self._missed_ticks >= HUNG_TICKS and not self._hung:
                self._hung = True
                stack = self._loop_stack()  # read first: the loop may have moved on when the arm has been stopped
                try:
                    self._on_hang()  # before the log is written, which may block
                except Exception:  # the watchdog must run on to detect the next hang
                    log.exception("the arm could not be stopped")
                log.critical("the event loop hangs, so the arm is stopped; the loop is at\n%s", stack)

    def _on_turn(self) -> None:
        if self._hung:
            log.warning("the event loop runs again")
        self._waiting, self._missed_ticks, self._hung = False, 0, False

    def _loop_stack(self) -> str:
        frame = sys._current_frames().get(self._loop_thread)
        return "".join(traceback.format_stack(frame)) if frame is not None else "an unknown line"
