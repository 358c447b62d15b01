"""The scan or calibration under way."""

import threading
from typing import Generic, TypeVar

from cell.control.prepared import Prepared
from service.errors import Failure, JobKind, JobReference
from service.states import ScanState
from service.storage.rows import CalibrationRow, ScanRow

R = TypeVar("R", bound=ScanRow | CalibrationRow)


def kind(row: ScanRow | CalibrationRow) -> JobKind:
    """What it is, in a word."""
    return "scan" if isinstance(row, ScanRow) else row.kind


class Running(Generic[R]):
    """One scan or calibration between its acceptance and its final state, and the wish to stop it."""

    def __init__(self, row: R, prepared: Prepared | None) -> None:
        self.row = row
        """As it was accepted."""
        self.prepared = prepared
        """What the arm will do, or None for a replay, for which the arm does nothing."""
        self.begun = threading.Event()
        """What was under way before it, with its picture, has ended."""
        self.ended = threading.Event()
        self.given_up = threading.Event()
        """The service is ending: its final row is written at once, or by the next start."""
        self._lock = threading.Lock()
        """Never held while something is written."""
        self._stop: tuple[ScanState, str] | None = None
        self._storing = False

    @property
    def words(self) -> str:
        """What it is, for people."""
        return f"{kind(self.row)} {self.row.id}"

    @property
    def reference(self) -> JobReference:
        """The job, as an error refers to it."""
        return JobReference(kind(self.row), self.row.id)

    @property
    def stop(self) -> tuple[ScanState, str] | None:
        """State to end in, and why, once somebody wants it stopped."""
        return self._stop

    def ask_to_stop(self, state: ScanState, detail: str) -> bool:
        """Whether it will be stopped; not when its result is being stored, nor a second time."""
        with self._lock:
            if self._storing or self._stop is not None:
                return False
            self._stop = (state, detail)
            return True

    def begin_storing(self) -> tuple[ScanState, str] | None:
        """From here on it can't be stopped; the wish to stop it that came before, if any."""
        with self._lock:
            self._storing = True
            return self._stop


def log_reason(state: str, failure: Failure | None) -> str:
    """Return the end of the log line of a job that ended in `state`; the name of the state is not repeated."""
    if failure is None:
        return ""
    return f": {failure.message}" if failure.slug == state else f": {failure.slug}: {failure.message}"
