"""What becomes of one accepted scan: its views, its outcome, its final state, its picture."""

import dataclasses
import logging
import shutil
import sqlite3
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

from cell.control.cell import Cell
from cell.control.prepared import PreparedScan
from cell.errors import CellError, StoppedError
from cell.recording.header import RecordingHeader
from recognition.grasping.gripper import Gripper
from service.errors import Failure
from service.jobs.calibration_drift import DriftWatch
from service.jobs.final_state import write_last
from service.jobs.inputs import recognition_inputs
from service.jobs.job import Running, log_reason
from service.jobs.live_scan import keep_recording, live_outcome
from service.logs.setup import log_scan
from service.metrics.scans import ScanMetrics
from service.processing.results import DONE_BEFORE, OnStage, Outcome
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task
from service.states import ScanState
from service.storage.data_folder import PREVIEW
from service.storage.database import now
from service.storage.rows import ScanRow
from service.storage.storage_errors import storage_failure
from service.storage.store import KEPT, Store

log = logging.getLogger(__name__)

Leaving = Callable[[Running[Any]], AbstractContextManager[None]]
"""The context in which a scan's final row is written: at its good end the one place is free."""


class ScanRunner:
    """Runs scans one after the other, in one thread; `drawing` belongs to any."""

    def __init__(
        self,
        store: Store,
        cell: Cell,
        worker: RecognitionWorker,
        recognition_limit_s: float,
        gripper: Gripper,
        leaving: Leaving,
        drift: DriftWatch,
        metrics: ScanMetrics,
    ) -> None:
        self._store, self._cell, self._worker = store, cell, worker
        self._limit_s, self._gripper, self._leaving = recognition_limit_s, gripper, leaving
        self._drift, self._metrics = drift, metrics
        self._begun_s = 0.0
        """When the scan at work began, `time.monotonic()`."""
        self.drawing: str | None = None
        """Id of the scan whose result is there and whose picture is to follow."""

    def run(self, running: Running[ScanRow]) -> None:
        """Brings a scan to its final state; a live one's arm is home when this returns, or has stopped."""
        self._begun_s = time.monotonic()
        with log_scan(running.row.id):
            log.info("scan %s begins: %s", running.row.id, _what(running))
            try:
                with ExitStack() as until_home:
                    self._run(running, until_home)
            except CellError as error:
                log.warning("behind scan %s the arm did not get home: %s", running.row.id, error)
            except Exception as error:  # whatever it is, this scan is told as failed and the next one is taken
                log.exception("scan %s could not be recorded", running.row.id)
                self._give_up(running, error)
        running.ended.set()

    def _run(self, running: Running[ScanRow], until_home: ExitStack) -> None:
        results = self._store.folder.incoming(running.row.id)
        outcome, stored = None, False
        try:
            outcome, failure = self._try(running, results, until_home)
            self._record(running, outcome, failure, results)
            stored = outcome is not None and running.stop is None
        finally:
            shutil.rmtree(results, ignore_errors=True)
            running.ended.set()
            self._end_preview(running.row, outcome is not None and self._worker.wait_for_preview() and stored)

    def _try(
        self, running: Running[ScanRow], results: Path, until_home: ExitStack
    ) -> tuple[Outcome | None, Failure | None]:
        """What the scan gives, or why it gives nothing; neither when it was stopped before it began."""
        try:
            if running.prepared is not None:
                self._store.update_scan(running.row.id, ("queued",), state="preflight")
            if running.stop is None:
                self._worker.start()
            # A stop that came before found no process to kill; one that comes from here on does.
            if running.stop is None:
                return self._outcome(running, results, until_home), None
        except TaskFailedError as error:
            return None, error.failure
        except StoppedError as error:
            running.ask_to_stop("aborted", str(error))  # unless whoever stopped the arm has said so, or said more
            return None, None
        except CellError as error:
            return None, Failure(error.slug, str(error))
        except OSError as error:
            failure = storage_failure(error, "what was recorded before is kept")
            if failure is None:
                raise
            return None, failure
        return None, None

    def _outcome(self, running: Running[ScanRow], results: Path, until_home: ExitStack) -> Outcome:
        """What the scan gives; a live one's arm is home when `until_home` is left."""
        scan, store, prepared = running.row, self._store, running.prepared
        if prepared is None:
            recording = store.recording(scan.recording or "")
            assert recording is not None
            task = self._task(scan, store.folder.recording(recording.id), results, recording.missing)
            inputs = recognition_inputs(task, recording.sha256)
            store.update_scan(scan.id, ("queued",), state="processing", started_at=now(), inputs=inputs)
            outcome = self._worker.run(task, self._progress(scan.id), self._limit_s)
            return dataclasses.replace(outcome, partial=outcome.partial or bool(recording.missing))
        assert isinstance(prepared, PreparedScan)
        task = self._task(scan, dataclasses.replace(prepared.header, string_radius_m=scan.string_radius_m), results)
        inputs = recognition_inputs(task)
        store.update_scan(scan.id, ("preflight",), state="scanning", started_at=now(), inputs=inputs)
        live = live_outcome(scan, prepared, self._cell, store, self._worker, task, self._limit_s, self._metrics)
        return until_home.enter_context(live)

    def _end_preview(self, scan: ScanRow, whole: bool) -> None:
        """The picture comes behind the result, which nobody shall wait for longer. What there is of one that is not
        `whole`, or of no stored result, goes. A scan whose picture cannot be kept has succeeded nonetheless."""
        drawn, results = self._store.folder.incoming(f"{scan.id}.png"), self._store.folder.results(scan.id)
        try:
            if whole and drawn.exists() and results.exists():  # retention may have removed them meanwhile
                drawn.replace(results / PREVIEW)
            drawn.unlink(missing_ok=True)  # a part, if it is still there
        except OSError as error:
            log.warning("the picture of scan %s could not be kept: %s", scan.id, error)
        finally:
            self.drawing = None

    def _task(self, scan: ScanRow, source: Path | RecordingHeader, results: Path, missing: Sequence[str] = ()) -> Task:
        preview = self._store.folder.incoming(f"{scan.id}.png")
        return Task(source, scan.string_radius_m, scan.method, self._gripper, results, preview, tuple(missing), scan.id)

    def _record(
        self, running: Running[ScanRow], outcome: Outcome | None, failure: Failure | None, results: Path
    ) -> None:
        scan, store, stop = running.row, self._store, running.begin_storing()
        with self._leaving(running):
            state: ScanState = "failed"
            if stop is not None:
                state, detail = stop
                failure = Failure(state, detail)
                store.end_scan(scan.id, state, failure)
            elif outcome is not None:
                state = "partial" if outcome.partial else "succeeded"
                self.drawing = scan.id
                store.finish_scan(scan.id, state, outcome.summary(), results, outcome.files)
            else:
                assert failure is not None
                store.end_scan(scan.id, state, failure)
        self._tell_end(scan, state, failure)
        if outcome is not None:
            self._metrics.recognised(outcome.timing_s, outcome.views)
        if stop is None and outcome is not None:
            self._keep_calibration_error(scan, outcome)

    def _keep_calibration_error(self, scan: ScanRow, outcome: Outcome) -> None:
        """Of a live scan only: a replay of it tells nothing new. The scan's result does not depend on it."""
        if scan.mode != "live" or outcome.calibration_error is None:
            return
        try:
            recording = self._store.recording(scan.id)
            sha256 = None if recording is None else recording.provenance.get("calibration_sha256")
            if sha256 is not None:
                self._drift.add(scan.id, sha256, outcome.calibration_error)
        except sqlite3.Error:
            log.exception("what scan %s tells of the calibration could not be kept", scan.id)

    def _tell_end(self, scan: ScanRow, state: str, failure: Failure | None) -> None:
        seconds = time.monotonic() - self._begun_s
        level = logging.WARNING if state == "failed" else logging.INFO
        log.log(level, "scan %s %s after %.1f s%s", scan.id, state, seconds, log_reason(state, failure))
        self._metrics.ended(scan.mode, state, seconds)

    def _give_up(self, running: Running[ScanRow], error: Exception) -> None:
        """The disk or the database failed. What the scan has recorded, and how it has ended, is written once either
        takes it again."""
        self.drawing = None
        scan, state = running.row, "failed"
        failure = storage_failure(error, KEPT) or Failure(
            "internal", "the result could not be stored; the log has the reason"
        )
        if running.stop is not None:
            state, detail = running.stop
            failure = Failure(state, detail)
        self._tell_end(scan, state, failure)

        def write() -> None:
            if scan.mode == "live":
                self._keep_recording(scan.id)
            self._store.end_scan(scan.id, state, failure)

        write_last(running, self._leaving, write)

    def _keep_recording(self, scan_id: str) -> None:
        try:
            keep_recording(self._store, scan_id)
        except OSError:
            log.exception("the recording of scan %s cannot be read; the next start tries again", scan_id)

    def _progress(self, scan_id: str) -> OnStage:
        def on_stage(name: str) -> None:
            self._store.update_scan(scan_id, ("queued", "processing"), stage=name, fraction=DONE_BEFORE[name])

        return on_stage


def _what(running: Running[ScanRow]) -> str:
    """What a scan is of."""
    if running.prepared is None:
        return f"replay of recording {running.row.recording}"
    return f"live, {len(running.prepared.plan.viewpoints)} views"
