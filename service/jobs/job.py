"""A job: one scan, calibration or verification between its acceptance and its final state."""

import threading
import time
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from cell.config.scan_views import Views
from cell.control.prepared import Prepared
from service.errors import Failure, JobKind, JobReference
from service.states import ScanState
from service.storage.rows import CalibrationRow, ScanRow

Row = TypeVar("Row", bound=ScanRow | CalibrationRow)


def kind_of(row: ScanRow | CalibrationRow) -> JobKind:
    """Return the kind of job that a row belongs to."""
    return "scan" if isinstance(row, ScanRow) else row.kind


@dataclass(frozen=True)
class StopRequest:
    """A request to end a job early."""

    state: ScanState
    """Final state of the job: `aborted` or `interrupted`."""
    reason: str
    """Why it ends, for people."""

    @property
    def failure(self) -> Failure:
        """Why the job has no result."""
        return Failure(self.state, self.reason)


@dataclass(frozen=True)
class UnpreparedScan:
    """A live scan that was accepted. The cell prepares it when the job runs."""

    views: Views | None
    """Number of viewpoints or `auto`; None for the configured value."""
    requested_at: float
    """Time of the request, monotonic seconds. A later stop cancels the scan."""


class Job(Generic[Row]):
    """One accepted scan, calibration or verification. Safe to use from any thread."""

    def __init__(self, row: Row, motion: UnpreparedScan | Prepared | None) -> None:
        self.row = row
        """Row of the job as it was accepted."""
        self.motion = motion
        """What the arm will do; None for a replay, in which it does nothing."""
        self.accepted_at = time.monotonic()
        """Time of the acceptance, monotonic seconds."""
        self.timing: dict[str, Any] = {}
        """Durations of the parts of the job so far, seconds, as JSON. Only the thread that runs the job uses them."""
        self.prepared = threading.Event()
        """What the arm will do is planned, or the arm does nothing. Recognition does not begin before."""
        if not isinstance(motion, UnpreparedScan):
            self.prepared.set()
        self.started = threading.Event()
        """The previous job has ended, with its preview, and this one runs."""
        self.ended = threading.Event()
        """The final row is written."""
        self.shutting_down = threading.Event()
        """The service is ending. The final row is written at once, or else by the next start."""
        self._lock = threading.Lock()
        """Never held during a write."""
        self._stop: StopRequest | None = None
        self._storing = False

    @property
    def kind(self) -> JobKind:
        """Kind of the job."""
        return kind_of(self.row)

    @property
    def uses_arm(self) -> bool:
        """Whether the job uses the arm."""
        return self.motion is not None

    @property
    def elapsed_s(self) -> float:
        """Time since the acceptance, seconds."""
        return time.monotonic() - self.accepted_at

    @property
    def label(self) -> str:
        """Kind and id, for messages."""
        return f"{self.kind} {self.row.id}"

    @property
    def reference(self) -> JobReference:
        """The job, as an error refers to it."""
        return JobReference(self.kind, self.row.id)

    @property
    def stop(self) -> StopRequest | None:
        """The first request to stop the job, if any."""
        return self._stop

    def request_stop(self, state: ScanState, reason: str) -> bool:
        """Ask the job to end in `state`.

        Returns:
            Whether it will: False if its result is being stored, or if it was stopped before.
        """
        with self._lock:
            if self._storing or self._stop is not None:
                return False
            self._stop = StopRequest(state, reason)
            return True

    def begin_storing(self) -> StopRequest | None:
        """Reject later stops, and return an earlier one."""
        with self._lock:
            self._storing = True
            return self._stop
