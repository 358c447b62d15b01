"""The one place for what is under way: a scan or a calibration."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cell.errors import CellError
from service.errors import ServiceError
from service.jobs.job import Running

SOON_S = 1.0
"""Whoever finds that something is being prepared waits so long to be told what. A replay is accepted within
milliseconds; for a live scan the cell may have to be connected first."""
TURN_S = 0.5
"""Taking or leaving the place is a matter of milliseconds, unless the database is held by another program: then whoever
comes next is not to wait for him who waits for it, and so on."""


class Place:
    """Taken for the time from the wish to do something to its final state. Safe to use from any thread."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        """Of taking and leaving the place, each together with its row: whoever reads that a scan has ended finds the
        place free."""
        self._decided = threading.Condition(self._turn)
        """Told when what was prepared is accepted, or is not."""
        self._running: Running[Any] | None = None
        self._preparing = False
        """Taken for what is not accepted yet."""
        self._closed = False

    @property
    def running(self) -> Running[Any] | None:
        """What is accepted and has not ended."""
        return self._running

    @property
    def closed(self) -> bool:
        """Nothing more begins."""
        return self._closed

    def refuse_more(self) -> None:
        """From now on nothing more is accepted but what is just being; waits for nobody."""
        self._closed = True

    def close(self) -> Running[Any] | None:
        """For good; gives what is under way."""
        with self._turn:
            self._closed = True
            return self._running

    @contextmanager
    def taken(self) -> Iterator[None]:
        """The place for as long as it takes to accept something; free again afterwards unless it was.

        Raises:
            ServiceError: `cell-busy`, with what is under way; `busy` when the row of what is accepted
                or has ended cannot be written at once; `not-ready` once it is closed.
        """
        latest = time.monotonic() + TURN_S + SOON_S + TURN_S
        if not self._turn.acquire(timeout=TURN_S):
            raise _busy()
        try:
            self._decided.wait_for(lambda: self._running is not None or not self._preparing, SOON_S)
            if time.monotonic() > latest:  # it was waited for the turn once more
                raise _busy()
            self._refuse_if_closed()
            if self._running is not None:
                raise _taken_by(self._running)
            if self._preparing:
                raise ServiceError(
                    "cell-busy", "something else is being prepared; try again in some seconds", retry_after_s=2.0
                )
            self._preparing = True
        finally:
            self._turn.release()
        try:
            yield
        except CellError:
            self._refuse_if_closed()  # arm and camera were given up: that says nothing of them
            raise
        finally:
            with self._turn:
                self._preparing = False
                self._decided.notify_all()

    def accept(self, running: Running[Any], write: Callable[[], None], begin: Callable[[], None]) -> None:
        """Within `taken`: the place is `running`'s once `write` has written its row, and then it is begun.

        All that before the place can be closed: what has it when it is closed has begun.

        Raises:
            ServiceError: `not-ready`, it was closed meanwhile.
        """
        with self._turn:
            self._refuse_if_closed()
            write()
            self._running = running
            begin()
            self._decided.notify_all()

    @contextmanager
    def leaving(self, running: Running[Any]) -> Iterator[None]:
        """The context in which the final row is written: at its end the place is free. Left by an exception, it is
        not."""
        with self._turn:
            yield
            if self._running is running:
                self._running = None

    def _refuse_if_closed(self) -> None:
        if self._closed:
            raise ServiceError("not-ready", "the service is stopping")


def _taken_by(running: Running[Any]) -> ServiceError:
    if running.stop is None:
        detail = f"{running.words} is under way; wait for its end or cancel it"
        return ServiceError("cell-busy", detail, job=running.reference)
    detail = f"{running.words} was stopped and is just ending; try again"
    return ServiceError("cell-busy", detail, retry_after_s=1.0, job=running.reference)


def _busy() -> ServiceError:
    detail = "the database is held by another program, or the disk is slow; try again"
    return ServiceError("busy", detail, retry_after_s=5.0)
