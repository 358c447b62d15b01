"""Which stop counts for what: one that came since something was asked for keeps it from moving."""

import math
import threading
import time

from cell.control.status import KeptStatus
from cell.errors import STOPPED, StoppedError

TOO_LATE = "the arm was stopped after this was asked for, so it has not moved: ask again if it is still wanted"

NOT_HOME = (
    "the arm was stopped after this was asked for, and may not be home: look why and where it stands, and ask again"
)


class Stops:
    """The stops that somebody asked for. Safe to use from any thread; nothing here waits."""

    def __init__(self, status: KeptStatus) -> None:
        self._status = status
        self._lock = threading.Lock()
        """Held for no longer than a number takes."""
        self._last_s = -math.inf

    def note(self) -> None:
        """Somebody asks for a stop; the arm is stopped, and `told` called, behind this."""
        with self._lock:  # of two at once, the one that read the clock later counts
            self._last_s = time.monotonic()

    def told(self) -> None:
        """A cell that was ready is not any more."""
        self._status.no_longer_ready("stopped", STOPPED)

    def since(self, asked_s: float) -> bool:
        """One came since then, by `time.monotonic()`."""
        return self._last_s >= asked_s

    def refuse_since(self, asked_s: float) -> None:
        """Raises StoppedError when one came; a cell that is ready by now, though it was stopped, is not any more."""
        if self.since(asked_s):
            self.told()
            raise StoppedError(TOO_LATE)

    def refuse_handing_over(self, asked_s: float) -> None:
        """Raises StoppedError when one came: who waits for the arm would move it behind the stop."""
        if self.since(asked_s):
            raise StoppedError(NOT_HOME)

    def refuse_stale(self, asked_s: float) -> None:
        """The same, but whoever has connected since finds the cell as it was: it may have been long ago."""
        if self.since(asked_s):
            raise StoppedError(TOO_LATE)
