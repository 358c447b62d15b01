"""The time of the last stop request, which cancels every request before it."""

import math
import threading
import time

from cell.control.status import SharedStatus
from cell.errors import STOPPED, StoppedError

STOPPED_SINCE = (
    "the arm was stopped after this request, so the request did not move it: check where the arm stands, then "
    "request again"
)


class StopRequests:
    """The last stop request. Every method may be called from any thread and returns without waiting."""

    def __init__(self, status: SharedStatus) -> None:
        self._status = status
        self._lock = threading.Lock()
        self._last_s = -math.inf

    def record(self) -> None:
        """Record a stop request, before the arm is stopped."""
        with self._lock:  # of two stops at once, the later time is kept
            self._last_s = time.monotonic()

    def is_stopped_since(self, requested_at: float) -> bool:
        """Whether a stop was requested at or after `requested_at`, monotonic seconds."""
        return self._last_s >= requested_at

    def mark_not_ready(self) -> None:
        """Make a ready cell not ready, because its arm was stopped."""
        self._status.leave_ready("stopped", STOPPED)

    def raise_if_stopped_since(self, requested_at: float) -> None:
        """Raise StoppedError if a stop was requested at or after `requested_at`, monotonic seconds.

        A cell that became ready by a connection older than the stop is then no longer ready.
        """
        last_s = self._last_s
        if last_s >= requested_at:
            self._status.leave_ready("stopped", STOPPED, connected_before=last_s)
            raise StoppedError(STOPPED_SINCE)
