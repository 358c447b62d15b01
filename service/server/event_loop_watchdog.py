"""Notices when the event loop hangs: then no stop comes through any more, so the arm is stopped."""

import asyncio
import logging
import sys
import threading
import traceback
from collections.abc import Callable

log = logging.getLogger(__name__)

TICK_S = 0.1
HUNG_TICKS = 12
"""The loop hangs when this thread was woken so many times and the loop not once. Not a time by the clock: where the
whole machine stands still, this thread does too."""


class LoopWatch:
    """A thread that looks whether a loop still turns.

    It needs the interpreter's lock. Where something holds that for ever, the arm's controller is no longer heard from
    either, and its watchdog stops the arm.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, hung: Callable[[], None]) -> None:
        """Begins at once, in the loop's thread. `hung` is called once each time that the loop hangs."""
        self._loop, self._hung = loop, hung
        self._loop_thread = threading.get_ident()
        self._missed = 0
        self._waiting = False
        self._told = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="loop-watch", daemon=True)
        self._thread.start()

    @property
    def turning(self) -> bool:
        """The loop does not hang."""
        return not self._told

    def close(self) -> None:
        """Returns when the watch has ended."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(TICK_S):
            if not self._waiting:
                self._waiting = True
                try:
                    self._loop.call_soon_threadsafe(self._turned)
                except RuntimeError:  # closed: the service has ended
                    return
            self._missed += 1
            if self._missed >= HUNG_TICKS and not self._told:
                self._told = True
                doing = self._doing()  # by the time that the arm is stopped, it may be elsewhere
                try:
                    self._hung()  # before anything is written, which may wait
                except Exception:  # the watch goes on: nobody else would notice the next time
                    log.exception("the arm could not be stopped")
                log.critical("the event loop hangs, the arm is stopped; it is at\n%s", doing)

    def _turned(self) -> None:
        if self._told:
            log.warning("the event loop turns again")
        self._waiting, self._missed, self._told = False, 0, False

    def _doing(self) -> str:
        frame = sys._current_frames().get(self._loop_thread)
        return "".join(traceback.format_stack(frame)) if frame is not None else "an unknown place"
