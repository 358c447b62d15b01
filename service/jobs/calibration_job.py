"""The work of a calibration or a verification: views, solution, result."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.errors import BoardDetectionError, HandEyeError
from cell.control.calibration_run import run_calibration, run_verification
from cell.control.cell import Cell
from cell.control.prepared import PreparedCalibration, PreparedVerification
from cell.errors import CellError
from service.errors import Failure
from service.jobs.job import Job
from service.jobs.progress import StoredProgress
from service.jobs.runner import JobCancelledError
from service.states import ScanState
from service.storage.database import now
from service.storage.rows import CalibrationRow
from service.storage.storage_errors import storage_failure
from service.storage.store import Store

KEPT = "the images taken before are kept"


@dataclass(frozen=True)
class CalibrationOutcome:
    """What a run gave, as JSON."""

    result: dict[str, Any] | None
    """Result of a calibration; None for a verification."""
    verification: dict[str, Any]


class CalibrationWork:
    """Does calibrations and verifications, one at a time, in one thread."""

    def __init__(self, store: Store, cell: Cell) -> None:
        self._store, self._cell = store, cell

    def describe(self, job: Job[CalibrationRow]) -> str:
        """Return how many poses the run has."""
        return f"{job.row.poses} poses"

    @contextmanager
    def execute(self, job: Job[CalibrationRow]) -> Iterator[CalibrationOutcome]:
        """Move the arm, then solve or verify once it is home. Yields the result.

        Raises:
            JobCancelledError: The run was stopped before it began.
            CellError: Too few views could be taken.
            HandEyeError, BoardDetectionError: The views give no result.
            OSError, sqlite3.Error: The disk or the database failed.
        """
        row, prepared = job.row, job.motion
        self._store.calibrations.update(row.id, ("queued",), state="preflight")
        if job.stop is not None:
            raise JobCancelledError
        assert isinstance(prepared, PreparedCalibration | PreparedVerification)
        folder = run_folder(self._cell, row.id)
        self._store.calibrations.update(row.id, ("preflight",), state="scanning", started_at=now())
        progress = StoredProgress(self._store, row, len(prepared.plan.viewpoints))
        if isinstance(prepared, PreparedVerification):
            yield CalibrationOutcome(None, run_verification(self._cell, prepared, folder, progress).to_json())
            return
        run = run_calibration(self._cell, prepared, folder, progress)
        yield CalibrationOutcome(json.loads((folder / HAND_EYE_FILE).read_bytes()), run.verification.to_json())

    def failure_of(self, error: Exception) -> Failure | None:
        """Return why the run failed; None for an error that is unexpected."""
        if isinstance(error, CellError | HandEyeError | BoardDetectionError):
            return Failure(error.slug, str(error))
        if isinstance(error, OSError):
            failure = storage_failure(error, KEPT)
            if failure is None and error.filename is not None:
                failure = Failure("file", f"{error.filename} cannot be written: {error.strerror}; {KEPT}")
            return failure
        return None

    def store(self, job: Job[CalibrationRow], result: CalibrationOutcome) -> ScanState:
        """Write the final row with the result."""
        ended = {"state": "succeeded", "stage": None, "fraction": 1.0, "ended_at": now()}
        self._store.calibrations.update(job.row.id, **ended, result=result.result, verification=result.verification)
        return "succeeded"

    def end(self, job: Job[CalibrationRow], state: ScanState, failure: Failure) -> None:
        """Write the final row of a run without a result."""
        self._store.calibrations.end(job.row.id, state, failure)

    def unexpected_failure(self, job: Job[CalibrationRow], error: Exception) -> Failure:
        """Return why the run failed that met an unexpected error, or whose final row could not be written."""
        internal = Failure("internal", f"the {job.kind} met an unexpected error; the log has it")
        return storage_failure(error, KEPT) or internal

    def on_end(self, job: Job[CalibrationRow], state: ScanState, duration_s: float) -> None:
        """Do nothing: calibrations have no metrics."""

    def finish(self, job: Job[CalibrationRow], result: CalibrationOutcome | None, stored: bool) -> None:
        """Do nothing: everything is written before the final row."""


def picture_file(folder: Path, index: int) -> Path | None:
    """Return the image of a view in the folder of its run; None if there is none."""
    return next(iter(sorted(folder.glob(f"*_pose{index:02d}.png"))), None)


def run_folder(cell: Cell, run_id: str) -> Path:
    """Return the folder with the images and the result of a run."""
    kept = cell.settings.hand_eye.folder
    assert kept is not None, "the service's configuration always names one"
    return kept / "runs" / run_id
