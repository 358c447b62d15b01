"""The work of a scan: views, recognition, result, preview."""

import dataclasses
import logging
import shutil
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from cell.control.cell import Cell
from cell.control.prepared import PreparedScan
from cell.errors import CellError
from cell.planning.expected_duration import ExpectedDuration
from cell.planning.viewpoints import ViewpointPlan
from cell.recording.header import RecordingHeader
from recognition.model.findings import finding
from service.errors import Failure
from service.jobs.calibration_drift import DriftWatch
from service.jobs.inputs import recognition_inputs
from service.jobs.job import Job, UnpreparedScan
from service.jobs.live_scan import keep_recording, run_live_scan
from service.jobs.runner import JobCancelledError
from service.metrics.scans import ScanMetrics
from service.processing.results import STAGE_START_FRACTION, OnStage, Outcome, hash_and_size, write_model
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task
from service.states import ScanState
from service.storage.data_folder import PREVIEW
from service.storage.database import now
from service.storage.rows import ScanRow
from service.storage.scan_store import KEPT
from service.storage.storage_errors import storage_failure
from service.storage.store import Store

log = logging.getLogger(__name__)


class ScanWork:
    """Does scans, one at a time, in one thread. `drawing` and `planned` may be read from any thread."""

    def __init__(
        self,
        store: Store,
        cell: Cell,
        worker: RecognitionWorker,
        recognition_limit_s: float,
        drift: DriftWatch,
        metrics: ScanMetrics,
    ) -> None:
        self._store, self._cell, self._worker = store, cell, worker
        self._limit_s = recognition_limit_s
        self._drift, self._metrics = drift, metrics
        self.drawing: str | None = None
        """Id of the scan whose result is stored and whose preview is being drawn."""
        self.planned: tuple[str, ViewpointPlan] | None = None
        """Id and plan of the last live scan that was planned."""

    def describe(self, job: Job[ScanRow]) -> str:
        """Return what the scan is of."""
        return f"replay of recording {job.row.recording}" if job.row.mode == "replay" else "live"

    @contextmanager
    def execute(self, job: Job[ScanRow]) -> Iterator[Outcome]:
        """Take the views of a live scan or read a recording, and recognise them.

        For a live scan the cell is first connected, if needed, and the viewpoints are planned. Yields the result. The
        arm of a live scan is home at the end of the context.

        Raises:
            JobCancelledError: The scan was stopped before it began.
            CellError: The cell cannot do the scan, the views could not be taken, or the arm did not return home.
            TaskFailedError: Recognition gave no result.
            OSError, sqlite3.Error: The disk or the database failed.
        """
        results = self._store.folder.incoming(job.row.id)
        job.timing["wait"] = round(job.elapsed_s, 3)
        prepared: PreparedScan | None = None
        try:
            if isinstance(job.motion, UnpreparedScan) and job.stop is None:
                prepared = self._prepare(job, job.motion)
                job.prepared.set()  # before `stop` is read: a stop reads them in the other order
            if job.stop is None:
                self._worker.start()
            # An earlier stop found no process to kill; from here on a stop finds one.
            if job.stop is not None:
                raise JobCancelledError
            if prepared is None:
                yield self._replay(job.row, results)
            else:
                with self._live(job, prepared, results) as outcome:
                    yield outcome
                self._write_return(job)
        finally:
            shutil.rmtree(results, ignore_errors=True)

    def failure_of(self, error: Exception) -> Failure | None:
        """Return why the scan failed; None for an error that is unexpected."""
        if isinstance(error, TaskFailedError):
            return error.failure
        if isinstance(error, CellError):
            return Failure(error.slug, str(error))
        if isinstance(error, OSError):
            return storage_failure(error, "what was recorded before is kept")
        return None

    def store(self, job: Job[ScanRow], result: Outcome) -> ScanState:
        """Move the result into place and write the final row."""
        scan, state = job.row, "partial" if result.partial else "succeeded"
        self.drawing = scan.id
        results = self._store.folder.incoming(scan.id)
        recognition = {stage: round(seconds, 3) for stage, seconds in result.timing_s.items()}
        job.timing |= {"recognition": recognition, "to_model": round(job.elapsed_s, 3)}
        self._store.scans.finish(scan.id, state, result.summary(), results, result.files, job.timing)
        return state

    def end(self, job: Job[ScanRow], state: ScanState, failure: Failure) -> None:
        """Write the final row of a scan without a result. A live scan keeps its recording."""
        if job.row.mode == "live":  # `run_live_scan` has kept it, unless the disk or the database failed
            try:
                keep_recording(self._store, job.row.id)
            except OSError:
                log.exception("the recording of %s cannot be read; the next start tries again", job.label)
        self._store.scans.end(job.row.id, state, failure)

    def unexpected_failure(self, job: Job[ScanRow], error: Exception) -> Failure:
        """Return why the scan failed that met an unexpected error, or whose final row could not be written."""
        internal = Failure("internal", "the result could not be stored; the log has the reason")
        return storage_failure(error, KEPT) or internal

    def on_end(self, job: Job[ScanRow], state: ScanState, duration_s: float) -> None:
        """Count the scan in the metrics."""
        self._metrics.observe_scan(job.row.mode, state, duration_s)

    def finish(self, job: Job[ScanRow], result: Outcome | None, stored: bool) -> None:
        """Count the result, keep what it says about the calibration, and wait for its preview."""
        try:
            if result is not None:
                self._metrics.observe_recognition(result.timing_s, result.views)
                self._metrics.observe_findings(result.verdict, result.findings)
            if result is not None and stored:
                self._keep_calibration_error(job.row, result)
        finally:
            self._end_preview(job.row, result is not None and self._worker.wait_for_preview() and stored)

    def _prepare(self, job: Job[ScanRow], unprepared: UnpreparedScan) -> PreparedScan:
        """Connect the cell if needed, and plan the viewpoints. Nothing moves."""
        prepared = self._cell.prepare_scan(unprepared.views, unprepared.requested_at)
        job.timing |= {
            "connect": round(prepared.connect_s, 3),
            "plan": round(prepared.plan_s, 3),
            **_expected(prepared.expected),
        }
        log.info("%s has its plan: %d views", job.label, len(prepared.plan.viewpoints))
        self.planned = job.row.id, prepared.plan
        planned = {"calibration_sha256": prepared.hand_eye.sha256, "timing": job.timing}
        self._store.scans.update(job.row.id, ("connecting",), state="preflight", **planned)
        return prepared

    def _write_return(self, job: Job[ScanRow]) -> None:
        """Write when the arm was home. The scan has ended before."""
        job.timing["to_home"] = round(job.elapsed_s, 3)
        try:
            self._store.scans.set_timing(job.row.id, job.timing)
        except sqlite3.Error:  # the scan is complete without it
            log.exception("when the arm of %s was home could not be written", job.label)

    def _replay(self, scan: ScanRow, results: Path) -> Outcome:
        recording = self._store.recording(scan.recording or "")
        assert recording is not None
        task = self._task(scan, self._store.folder.recording(recording.id), results, recording.missing)
        inputs = recognition_inputs(recording.sha256)
        self._store.scans.update(scan.id, ("queued",), state="processing", started_at=now(), inputs=inputs)
        outcome = self._worker.run(task, self._on_stage(scan.id), self._limit_s)
        outcome = write_model(outcome, results, recording.sha256)
        return dataclasses.replace(outcome, partial=outcome.partial or bool(recording.missing))

    def _live(self, job: Job[ScanRow], prepared: PreparedScan, results: Path) -> AbstractContextManager[Outcome]:
        def expect_all_views() -> None:
            job.timing |= _expected(prepared.expected_with_all)
            self._store.scans.set_timing(job.row.id, job.timing)

        scan = job.row
        header = dataclasses.replace(prepared.header, string_radius_m=scan.request.radius_m)
        task = dataclasses.replace(self._task(scan, header, results), check_views=prepared.may_end_after is not None)
        inputs = recognition_inputs()
        self._store.scans.update(scan.id, ("preflight",), state="scanning", started_at=now(), inputs=inputs)
        return run_live_scan(
            scan, prepared, self._cell, self._store, self._worker, task, self._limit_s, self._metrics, expect_all_views
        )

    def _task(
        self,
        scan: ScanRow,
        source: Path | RecordingHeader,
        results: Path,
        missing: Sequence[str] = (),
    ) -> Task:
        preview = self._store.folder.incoming(f"{scan.id}.png")
        notes = tuple(finding("recording-incomplete", message) for message in missing)
        return Task(source, scan.request, results, preview, notes, scan.id)

    def _on_stage(self, scan_id: str) -> OnStage:
        def on_stage(name: str) -> None:
            fraction = STAGE_START_FRACTION[name]
            self._store.scans.update(scan_id, ("queued", "processing"), stage=name, fraction=fraction)

        return on_stage

    def _keep_calibration_error(self, scan: ScanRow, outcome: Outcome) -> None:
        """Keep the hand-eye error that a live scan estimates. A replay of the scan gives no new estimate."""
        if scan.mode != "live" or outcome.calibration_error is None:
            return
        try:
            recording = self._store.recording(scan.id)
            sha256 = None if recording is None else recording.provenance.get("calibration_sha256")
            if sha256 is not None:
                self._drift.add(scan.id, sha256, outcome.calibration_error)
        except sqlite3.Error:  # the result of the scan does not depend on it
            log.exception("the calibration error that scan %s estimates could not be kept", scan.id)

    def _end_preview(self, scan: ScanRow, complete: bool) -> None:
        """Move a complete preview to the result, or remove it. A scan without a preview has succeeded all the same."""
        drawn, results = self._store.folder.incoming(f"{scan.id}.png"), self._store.folder.results(scan.id)
        try:
            if complete and drawn.exists() and results.exists():  # retention may have removed the result meanwhile
                picture = hash_and_size(drawn.read_bytes())
                drawn.replace(results / PREVIEW)
                self._store.scans.add_file(scan.id, PREVIEW, picture)
            drawn.unlink(missing_ok=True)  # an incomplete file
        except (OSError, sqlite3.Error) as error:
            log.warning("the preview of scan %s could not be kept: %s", scan.id, error)
        finally:
            self.drawing = None


def _expected(expected: ExpectedDuration) -> dict[str, float | list[float]]:
    return {
        "expected_to_model": round(expected.to_model_s, 1),
        "expected_to_home": round(expected.to_home_s, 1),
        "expected_to_views": [round(seconds, 3) for seconds in expected.to_views_s],
    }
