"""In which state a cell is."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

from calibration.storage.hand_eye_file import HandEye
from cell.devices import ArmInfo, ArmState, CameraInfo
from cell.errors import CellError, EmergencyStopError, MotionError, ProtectiveStopError, RobotLostError
from cell.planning.viewpoints import ViewpointPlan

log = logging.getLogger(__name__)

State = Literal["not_ready", "ready", "busy", "fault"]

SAFETY_STOPS = (ProtectiveStopError, EmergencyStopError)
"""A person must look at the cell and acknowledge them ..."""
FAULTS = (*SAFETY_STOPS, RobotLostError, MotionError)
"""... and these, when the arm was moving: nobody else knows how it stands."""


@dataclass(frozen=True)
class CellStatus:
    """The cell as last seen; reading it asks no device anything."""

    state: State = "not_ready"
    reason: str | None = "not connected yet: connect, or start a live scan"
    """Why it is not ready, and what to do."""
    slug: str | None = "not-connected"
    """The same for programs."""
    arm: ArmInfo | None = None
    arm_state: ArmState | None = None
    """The last that was heard of it; an arm that is not connected may have moved since."""
    camera: CameraInfo | None = None
    hand_eye: HandEye | None = None
    plan: ViewpointPlan | None = None
    """The last one."""


Listener = Callable[[CellStatus], None]
"""Is told each new status, in order and one at a time, by whichever thread has changed it: it must not wait."""


class KeptStatus:
    """The status as several threads change it: no change of one gets lost by another's."""

    def __init__(self) -> None:
        self._status = CellStatus()
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._listeners: tuple[Listener, ...] = ()
        self._untold: deque[CellStatus] = deque()
        self._telling = threading.Lock()

    @property
    def now(self) -> CellStatus:
        """The status at this moment."""
        return self._status

    def tell(self, listener: Listener) -> None:
        """From the next change on, `listener` is told of each."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def wait_while_busy(self, seconds: float) -> None:
        """Returns when the state is another than busy, or after so long."""
        with self._changed:
            self._changed.wait_for(lambda: self._status.state != "busy", seconds)

    def change(self, **values: Any) -> None:
        """Sets fields of the status."""
        with self._lock:
            self._set(values)
        self._tell()

    def no_longer_ready(self, slug: str, reason: str) -> None:
        """Makes a ready cell one that is not; any other state stays."""
        with self._lock:
            if self._status.state == "ready":
                self._set({"state": "not_ready", "slug": slug, "reason": reason})
        self._tell()

    def after(self, error: BaseException | None, faults: tuple[type[CellError], ...] = SAFETY_STOPS) -> None:
        """The state that follows from how something ended; `faults` are what a person must acknowledge."""
        if error is None:
            self.change(state="ready", slug=None, reason=None)
        elif isinstance(error, faults):
            log.warning("fault: %s", error)
            first = "" if isinstance(error, SAFETY_STOPS) else "look at the cell and acknowledge first: "
            self.change(state="fault", slug=error.slug, reason=f"{first}{error}")
        elif isinstance(error, CellError):
            self.change(state="not_ready", slug=error.slug, reason=str(error))
        else:
            reason = "the last scan or calibration ended in an error: connect, or start a live scan"
            self.change(state="not_ready", slug="stopped", reason=reason)

    def _set(self, values: dict[str, Any]) -> None:
        self._status = replace(self._status, **values)
        self._untold.append(self._status)
        self._changed.notify_all()

    def _tell(self) -> None:
        """Waits for nobody: who finds another one telling leaves his own change to him."""
        while self._untold and self._telling.acquire(blocking=False):
            try:
                while self._untold:
                    self._tell_one(self._untold.popleft())
            finally:
                self._telling.release()

    def _tell_one(self, status: CellStatus) -> None:
        for listener in self._listeners:
            try:
                listener(status)
            except Exception:  # neither the cell nor the other listeners may suffer from it
                log.exception("a listener to the cell's status failed")
