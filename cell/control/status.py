"""The state of a cell, and the status that describes it.

docs/contributor/cell-states.md has the diagram of the states and of who changes them.
"""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

from calibration.storage.hand_eye_file import HandEye
from cell.devices import ArmInfo, ArmState, CameraInfo
from cell.errors import (
    AcknowledgeRequiredError,
    CellError,
    EmergencyStopError,
    MotionError,
    ProtectiveStopError,
    RobotLostError,
)
from cell.planning.viewpoints import ViewpointPlan

log = logging.getLogger(__name__)

State = Literal["not_ready", "ready", "busy", "fault"]

SAFETY_STOPS = (ProtectiveStopError, EmergencyStopError)
"""Errors that always make a fault. A person must inspect the cell and acknowledge it."""
FAULTS = (*SAFETY_STOPS, RobotLostError, MotionError)
"""Errors that make a fault during a run, because the posture of the arm is then unknown."""


@dataclass(frozen=True)
class CellStatus:
    """Last known status of the cell. Reading it queries no device."""

    state: State = "not_ready"
    """State of the cell."""
    reason: str | None = "not connected yet: connect, or start a live scan"
    """Why the cell is not ready and what to do, or None."""
    slug: str | None = "not-connected"
    """Code of the reason for programs, or None."""
    arm: ArmInfo | None = None
    """Arm that was connected last."""
    arm_state: ArmState | None = None
    """Last state that the arm reported. An arm that is not connected may have moved since."""
    camera: CameraInfo | None = None
    """Camera that was connected last."""
    hand_eye: HandEye | None = None
    """Calibration that was loaded last."""
    plan: ViewpointPlan | None = None
    """Last plan of a scan."""


Listener = Callable[[CellStatus], None]
"""Receives each new status in order, from any thread, one call at a time. It must not wait: a stop may wait for it."""


class SharedStatus:
    """A status that several threads change, each change in one step."""

    def __init__(self) -> None:
        self._status = CellStatus()
        self._connected_at = -math.inf
        """Start of the connection that made the cell ready, monotonic seconds."""
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._listeners: tuple[Listener, ...] = ()
        self._pending: deque[CellStatus] = deque()
        """Statuses that the listeners have not received yet."""
        self._notifying = threading.Lock()

    @property
    def now(self) -> CellStatus:
        """Current status."""
        return self._status

    def subscribe(self, listener: Listener) -> None:
        """Call `listener` at each change from now on."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

    def wait_while_busy(self, timeout_s: float) -> None:
        """Return when the state is not busy, or after the timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self._status.state != "busy", timeout_s)

    def raise_if_fault(self) -> None:
        """Raise AcknowledgeRequiredError in state `fault`."""
        status = self._status
        if status.state == "fault":
            raise AcknowledgeRequiredError(status.reason)

    def change(self, **values: Any) -> None:
        """Set fields of the status."""
        self._change(values)

    def set_connected(self, started_at: float, **values: Any) -> None:
        """Make the cell ready by a connection that was started at `started_at`, monotonic seconds."""
        self._change({"state": "ready", "slug": None, "reason": None, **values}, connected_at=started_at)

    def leave_ready(self, slug: str, reason: str, connected_before: float = math.inf) -> None:
        """Make a ready cell not ready; any other state stays.

        Args:
            slug: Code of the reason.
            reason: Why the cell is not ready, and what to do.
            connected_before: Monotonic seconds. A cell whose connection was started later stays ready.
        """
        values = {"state": "not_ready", "slug": slug, "reason": reason}
        self._change(values, lambda: self._status.state == "ready" and self._connected_at <= connected_before)

    def set_outcome(self, error: BaseException | None, faults: tuple[type[CellError], ...] = SAFETY_STOPS) -> None:
        """Set the state that follows from the end of an operation.

        Args:
            error: Error that ended the operation, or None for success.
            faults: Errors that make a fault.
        """
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

    def _change(
        self,
        values: dict[str, Any],
        condition: Callable[[], bool] | None = None,
        connected_at: float | None = None,
    ) -> None:
        """Set fields of the status if the condition holds, and notify the listeners."""
        with self._lock:
            if condition is None or condition():
                self._status = replace(self._status, **values)
                self._connected_at = self._connected_at if connected_at is None else connected_at
                self._pending.append(self._status)
                self._changed.notify_all()
        # a thread that finds another one notifying leaves its own change to that one, and does not wait
        while self._pending and self._notifying.acquire(blocking=False):
            try:
                while self._pending:
                    status = self._pending.popleft()
                    for listener in self._listeners:
                        try:
                            listener(status)
                        except Exception:  # a failing listener must not affect the cell or the other listeners
                            log.exception("a listener to the cell's status failed")
            finally:
                self._notifying.release()
