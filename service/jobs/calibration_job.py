"""What becomes of one accepted calibration or verification: its views, its result, its final state."""

import json
import logging
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.errors import BoardDetectionError, HandEyeError
from cell.control.calibration_run import BoardObservation, run_calibration, run_verification
from cell.control.cell import Cell
from cell.control.prepared import PreparedCalibration, PreparedVerification
from cell.errors import CellError, StoppedError
from service.errors import Failure
from service.jobs.final_state import write_last
from service.jobs.job import Running, log_reason
from service.storage.calibration_store import CalibrationStore
from service.storage.database import now
from service.storage.rows import CalibrationRow
from service.storage.storage_errors import storage_failure
from service.storage.store import Store

log = logging.getLogger(__name__)

VIEWS_SHARE = 0.9
"""Of a calibration's time, taking the views takes so much."""


class StoredCalibrationProgress:
    """Writes down how a calibration goes: the intent before each move, and what was seen in each view."""

    def __init__(self, store: CalibrationStore, calibration_id: str, views: int) -> None:
        self._store, self._id, self._views, self._done = store, calibration_id, views, 0

    def moving(self, index: int) -> None:
        """The arm moves when this is on the disk."""
        self._store.set_view(self._id, index, "moving")

    def recorded(self, index: int) -> None:
        """The picture itself is on the disk."""
        self._store.set_view(self._id, index, "recorded")
        self._advance()

    def missing(self, index: int, reason: str) -> None:
        """There is no such view."""
        self._store.set_view(self._id, index, "missing", reason)
        self._advance()

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """The board was found in the picture; `coverage` is that of all pictures so far."""
        self._store.set_seen(self._id, index, board)
        self._store.update(self._id, ("scanning", "processing"), coverage=coverage)

    def not_detected(self, index: int, reason: str) -> None:
        """The board was not found in the picture."""
        self._store.set_unseen(self._id, index, reason)

    def home(self) -> None:
        """The arm is home."""
        self._store.update(self._id, ("scanning",), state="processing", stage="solving")

    def _advance(self) -> None:
        self._done += 1
        fraction = VIEWS_SHARE * self._done / self._views
        self._store.update(self._id, ("scanning",), stage="views", fraction=fraction)
        if self._done == self._views:
            self._store.update(self._id, ("scanning",), stage="going-home")


@dataclass(frozen=True)
class _Done:
    """What a run gave, as JSON."""

    result: dict[str, Any] | None
    verification: dict[str, Any]


class CalibrationRunner:
    """Runs calibrations and verifications one after the other, in one thread."""

    def __init__(
        self, store: Store, cell: Cell, leaving: Callable[[Running[Any]], AbstractContextManager[None]]
    ) -> None:
        """`leaving` is the context in which the final row is written: at its end the one place is free."""
        self._store, self._cell, self._leaving = store.calibrations, cell, leaving

    def run(self, running: Running[CalibrationRow]) -> None:
        """Brings it to its final state; the arm is home when this returns, or has stopped."""
        row = running.row
        log.info("%s begins: %d poses", running.words, row.poses)
        try:
            done, failure = self._try(running)
            self._record(running, done, failure)
        except Exception as error:  # whatever it is, this one is told as failed and the next is taken
            log.exception("%s could not be done", running.words)
            state, failure = "failed", storage_failure(error, "the pictures taken before are kept")
            if failure is None:
                failure = Failure("internal", f"the {row.kind} met an unexpected error; the log has it")
            if running.stop is not None:
                state, detail = running.stop
                failure = Failure(state, detail)
            write_last(running, self._leaving, lambda: self._store.end(row.id, state, failure))
        running.ended.set()

    def _try(self, running: Running[CalibrationRow]) -> tuple[_Done | None, Failure | None]:
        """What it gives, or why it gives nothing; neither when it was stopped."""
        try:
            self._store.update(running.row.id, ("queued",), state="preflight")
            if running.stop is None:
                return self._done(running), None
        except StoppedError as error:
            running.ask_to_stop("aborted", str(error))  # unless whoever stopped the arm has said so, or said more
        except CellError as error:
            return None, Failure(error.slug, str(error))
        except (HandEyeError, BoardDetectionError) as error:
            return None, Failure(error.slug, str(error))
        except OSError as error:
            failure = storage_failure(error, "the pictures taken before are kept")
            if failure is not None:
                return None, failure
            if error.filename is None:  # of no file
                raise
            detail = f"{error.filename} cannot be written: {error.strerror}; the pictures taken before are kept"
            return None, Failure("file", detail)
        return None, None

    def _done(self, running: Running[CalibrationRow]) -> _Done:
        """Moves the arm, and solves or verifies once it is home."""
        row, prepared = running.row, running.prepared
        folder = run_folder(self._cell, row.id)
        self._store.update(row.id, ("preflight",), state="scanning", started_at=now())
        assert prepared is not None
        told = StoredCalibrationProgress(self._store, row.id, len(prepared.plan.viewpoints))
        if isinstance(prepared, PreparedVerification):
            return _Done(None, run_verification(self._cell, prepared, folder, told).to_json())
        assert isinstance(prepared, PreparedCalibration)
        run = run_calibration(self._cell, prepared, folder, told)
        return _Done(json.loads((folder / HAND_EYE_FILE).read_bytes()), run.verification.to_json())

    def _record(self, running: Running[CalibrationRow], done: _Done | None, failure: Failure | None) -> None:
        row, stop = running.row, running.begin_storing()
        with self._leaving(running):
            if stop is not None:
                state, detail = stop
                failure = Failure(state, detail)
                self._store.end(row.id, state, failure)
            elif done is not None:
                state = "succeeded"
                ended = {"state": state, "stage": None, "fraction": 1.0, "ended_at": now()}
                self._store.update(row.id, **ended, result=done.result, verification=done.verification)
            else:
                assert failure is not None
                state = "failed"
                self._store.end(row.id, state, failure)
        level = logging.WARNING if state == "failed" else logging.INFO
        log.log(level, "%s %s%s", running.words, state, log_reason(state, failure))


def picture_file(folder: Path, index: int) -> Path | None:
    """The picture of a view in the folder of its run; None when there is none."""
    return next(iter(sorted(folder.glob(f"*_pose{index:02d}.png"))), None)


def run_folder(cell: Cell, run_id: str) -> Path:
    """The folder of a run's pictures and results."""
    kept = cell.settings.hand_eye.folder
    assert kept is not None, "the service's configuration always names one"
    return kept / "runs" / run_id
