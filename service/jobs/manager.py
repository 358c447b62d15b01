"""Accepts and runs jobs, one at a time: scans, calibrations and verifications.

One thread takes the accepted jobs and brings each to its final state. There is no queue: a cell has one arm, and a
request that comes while it is busy is refused with the job that is running.
"""

import logging
import math
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any

from cell.control.cell import Cell
from cell.control.stop_requests import STOPPED_SINCE
from cell.errors import StoppedError
from cell.planning.viewpoints import ViewpointPlan
from service.errors import ServiceError
from service.jobs.calibration_drift import DriftWatch
from service.jobs.calibration_job import CalibrationWork
from service.jobs.cell_lock import CellLock
from service.jobs.interventions import Interventions
from service.jobs.job import Job, kind_of
from service.jobs.live_scan import keep_recording
from service.jobs.runner import JobRunner
from service.jobs.scan_job import ScanWork
from service.jobs.submission import Submissions
from service.logs.request_time import arrival_time
from service.metrics.scans import ScanMetrics
from service.processing.worker import RecognitionWorker
from service.states import ScanState
from service.storage.database import new_id
from service.storage.rows import CalibrationRow, ScanRow
from service.storage.scan_store import KEPT
from service.storage.storage_errors import storage_failure
from service.storage.store import Store

log = logging.getLogger(__name__)

CANCEL_TIMEOUT_S = 5.0
"""How long a cancel waits for the end of the job. That takes milliseconds, or longer if a camera is just being searched
for or another program locks the database."""

STOP_TIMEOUT_S = 1.0
"""How long a stop waits for the arm to end what it does. The caller wants to know soon that the stop arrived."""

PREVIEW_TIMEOUT_S = 3.0
"""How long a scan that is cancelled before it began waits for the preview of the last one, which takes half a
second."""

GRACE_S = 0.3
"""How long a stopped live scan may take to end after its arm before its recognition process is killed. The next scan
would have to wait for a new process."""

IDLE_CHECK_S = 1.0
"""Interval at which an idle service checks that a recognition process is ready."""

CLEAN_UP_RETRY_S = 1.0
"""Interval of retries to end the jobs of an earlier service."""
START_CHECK_S = 0.05
"""The same interval while the process starts."""


class Jobs:
    """Accepts and runs jobs. Every method may be called from any thread and may block for a moment."""

    def __init__(
        self,
        store: Store,
        cell: Cell,
        recognition_limit_s: float,
        metrics: ScanMetrics | None = None,
    ) -> None:
        """Clean up after an earlier service, then start the recognition process.

        Unfinished jobs of the earlier service become interrupted, and its recordings without a row are added. If the
        disk is full or the database is locked, that is done as soon as it is possible.
        """
        self._store = store
        self._cell = cell
        self._worker = RecognitionWorker()
        self._metrics = metrics or ScanMetrics()
        self._lock = CellLock()
        self._stopped_at = -math.inf
        """Time of the last request to stop the arm, monotonic seconds."""
        self.interventions = Interventions()
        """Who stopped the arm last, and who acknowledged the last fault."""
        self.drift = DriftWatch(store.calibrations)
        """What recent scans say about the active calibration."""
        self._scans = ScanWork(store, cell, self._worker, recognition_limit_s, self.drift, self._metrics)
        calibrations = CalibrationWork(store, cell)
        self._runner = JobRunner(
            self._lock, {"scan": self._scans, "calibration": calibrations, "verification": calibrations}
        )
        self._state_writer = ThreadPoolExecutor(1, thread_name_prefix="stopping")
        """Writes the state `stopping`, so that a stop does not wait for the database."""
        self._accepted: queue.SimpleQueue[Job[Any] | None] = queue.SimpleQueue()
        self.submit = Submissions(store, cell, self._lock, self._accepted.put)
        """Accepts new jobs."""
        self._first_id = new_id()
        """Earlier ids are of jobs of an earlier service."""
        self._ending = threading.Event()
        self._cleaning = threading.Thread(target=self._clean_up_later, name="clean-up", daemon=True)
        if not self._clean_up():
            self._cleaning.start()
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    def _clean_up(self) -> bool:
        """End the jobs of an earlier service. Return False if the disk is full or the database is locked."""
        try:
            self._store.scans.interrupt_unfinished(self._first_id)
            self._store.calibrations.interrupt_unfinished(self._first_id)
            # All scans without a recording: an earlier start may have been killed here, or the database was locked.
            for scan in self._store.scans.without_recording(self._first_id):
                try:
                    keep_recording(self._store, scan.id)
                except OSError:
                    log.exception("the recording of scan %s cannot be read; the next start tries again", scan.id)
        except sqlite3.Error as error:
            if storage_failure(error, "") is None:
                raise
            log.warning("the jobs of the earlier service are not ended yet, and it is tried again: %s", error)
            return False
        return True

    def _clean_up_later(self) -> None:
        while not self._ending.wait(CLEAN_UP_RETRY_S):
            try:
                if self._clean_up():
                    return
            except sqlite3.Error:
                log.exception("the jobs of the earlier service cannot be ended; the next start tries again")
                return

    def drain(self) -> None:
        """Accept no further job, and end the running one as `interrupted`."""
        self._lock.refuse_more()
        # Without the lock: its holder may wait for the database, and the arm must not wait for that.
        job = self._lock.job
        if (
            job is not None or self._cell.status.state == "busy"
        ):  # an idle cell keeps its control program until it closes
            self._interrupt(job)
        accepted_last = self._lock.close()
        if accepted_last is not None and accepted_last is not job:
            self._interrupt(accepted_last)
        self._cell.cancel_connecting()

    def close(self) -> None:
        """Drain, and end the recognition process."""
        self._ending.set()
        if self._cleaning.ident is not None:
            self._cleaning.join()
        try:
            self.drain()
        finally:
            self._worker.kill()  # it may be starting
            self._accepted.put(None)
            self._thread.join()
            self._state_writer.shutdown()
            self._worker.close()

    @property
    def not_ready(self) -> str | None:
        """Why no scan can be done now; None if one can. A busy service is ready."""
        return self._worker.not_ready_reason

    def exclusive(self) -> AbstractContextManager[None]:
        """Return a context in which no job runs or begins.

        Raises:
            ServiceError: `cell-busy`, a job is running.
        """
        return self._lock.reserved()

    def plan_of(self, scan_id: str) -> ViewpointPlan | None:
        """Return the plan of a live scan. None before it is planned, and when a later one was planned."""
        planned = self._scans.planned
        return planned[1] if planned is not None and planned[0] == scan_id else None

    def is_drawing(self, scan_id: str) -> bool:
        """Return whether the preview of a scan that has a result is still being drawn."""
        return self._scans.drawing == scan_id

    def cancel(self, row_id: str, find: Callable[[], ScanRow | CalibrationRow], by: str | None = None) -> None:
        """Stop the job of this id, the arm first, and wait for its end. It may have succeeded a moment before.

        Args:
            row_id: Id of the job.
            find: Returns the row of the job. It is called only if the job is not running.
            by: Name of the caller, if it is known.

        Raises:
            ServiceError: `not-cancellable`, the job had ended already, and not because it was aborted; or what `find`
                raises.
        """
        job = self._lock.job
        if job is not None and job.row.id == row_id:
            # The arm may already work for the next job if this one has just ended.
            arm = job.uses_arm and not job.ended.is_set()
            if arm:
                self.interventions.record_stop(by)
            self._stop(job, "aborted", f"the {job.kind} was cancelled" + ("" if by is None else f" by {by}"), arm)
            job.ended.wait(CANCEL_TIMEOUT_S)
        elif (row := find()).state != "aborted":
            kind = kind_of(row)
            detail = f"the {kind} has ended already: it is {row.state}"
            raise ServiceError("not-cancellable", detail, kind=kind, state=row.state)

    def stop_arm(self, by: str | None = None, reason: str | None = None) -> str | None:
        """Stop the arm, and abort the job that uses it, if any.

        Waits for the arm to end its move or capture. The job ends after that, while its recording is being kept.

        Args:
            by: Name of the caller, if it is known.
            reason: Why the job ends, if not by request.

        Returns:
            Id of the scan that was stopped, if any.
        """
        self._stopped_at = time.monotonic()
        job = self._lock.job
        live = job if job is not None and job.uses_arm else None
        self.interventions.record_stop(by)
        self._stop(live, "aborted", reason or "the arm was stopped by request" + ("" if by is None else f" of {by}"))
        self._cell.wait_while_busy(STOP_TIMEOUT_S)
        return live.row.id if live is not None and isinstance(live.row, ScanRow) else None

    def raise_if_stopped_since(self, requested_at: float) -> None:
        """Raise StoppedError if a stop of the arm was requested at or after this time (monotonic seconds).

        A scan that was cancelled, or that ended with the service, does not count.
        """
        if self._stopped_at >= requested_at:
            raise StoppedError(STOPPED_SINCE)

    def stop_unattended(self) -> None:
        """Stop an arm that moves or is about to move, because the service does not answer: no one else could."""
        self._cell.reject_earlier_requests()  # jobs that are not accepted yet
        if self._cell.status.state == "busy" or self.using_arm is not None:
            reason = "the service did not answer for more than a second, so nobody could have stopped the arm"
            self.stop_arm(reason=reason)

    def release_arm(self, requested_at: float) -> None:
        """Release the arm for other programs once it is home.

        Args:
            requested_at: Time of the request, monotonic seconds. It is refused if the arm was stopped since.

        Raises:
            ServiceError: `cell-busy`, a job is running.
            CellError: As `Cell.release`.
        """
        with self._lock.reserved():
            self._cell.release(requested_at)

    def raise_if_busy(self) -> None:
        """Raise what a new job would be refused with: ServiceError `cell-busy` or `not-ready`."""
        self._lock.raise_if_occupied()

    @property
    def closed(self) -> bool:
        """The service is stopping and accepts no further job."""
        return self._lock.closed

    @property
    def recognition_starts(self) -> int:
        """Number of recognition processes started so far."""
        return self._worker.start_count

    @property
    def idle(self) -> bool:
        """No job is accepted that has not ended."""
        return self._lock.job is None

    @property
    def using_arm(self) -> str | None:
        """The running job that uses the arm, as a phrase such as "a scan"; None if there is none."""
        job = self._lock.job
        return f"a {job.kind}" if job is not None and job.uses_arm else None

    @property
    def calibration(self) -> str | None:
        """Id of the running calibration or verification; None if there is none."""
        job = self._lock.job
        return job.row.id if job is not None and isinstance(job.row, CalibrationRow) else None

    def _interrupt(self, job: Job[Any] | None) -> None:
        if job is not None:
            job.shutting_down.set()
        is_scan = job is not None and isinstance(job.row, ScanRow)
        advice = KEPT if is_scan else "start it again"
        self._stop(job, "interrupted", f"the service was stopped; {advice}")
        self._cell.cancel_connecting()  # the job may be waiting for a camera
        if job is not None:
            job.ended.wait(CANCEL_TIMEOUT_S)

    def _stop(self, job: Job[Any] | None, state: ScanState, reason: str, arm: bool = True) -> None:
        """Stop the arm, then the job, if any. The job ends later."""
        # The job learns the reason before the arm stops; its row is written after the arm stopped.
        requested = job is not None and job.request_stop(state, reason)
        if arm:
            since = arrival_time()
            self._cell.stop()
            self._metrics.observe_stop(time.monotonic() - since)
        if job is None or not requested:
            return
        try:
            if isinstance(job.row, ScanRow):
                self._end_recognition(job)
            self._state_writer.submit(self._write_stopping, job)
        except RuntimeError:  # no further thread can be started; the arm is stopped all the same
            log.exception("that %s is being stopped could not be written", job.label)

    def _write_stopping(self, job: Job[Any]) -> None:
        try:
            self._store.jobs(job.kind).update(job.row.id, state="stopping")
        except sqlite3.Error:
            log.exception("that %s is being stopped could not be written", job.label)

    def _end_recognition(self, job: Job[Any]) -> None:
        started = job.started.is_set()
        if started and not job.uses_arm:
            self._kill_unless_ended(job, 0.0)
            return
        if started and not job.prepared.is_set():
            return  # recognition has not begun and will not begin
        wait_s = GRACE_S if started or job.shutting_down.is_set() else PREVIEW_TIMEOUT_S
        threading.Thread(target=self._kill_unless_ended, args=(job, wait_s), name="ending").start()

    def _kill_unless_ended(self, job: Job[Any], wait_s: float) -> None:
        # A live scan ends with its arm, which may be in a capture that no stop interrupts. Its recognition process
        # stays for the next scan. It is killed only if it works on the last views.
        if job.uses_arm:
            self._cell.wait_while_busy(CANCEL_TIMEOUT_S)
        if not job.ended.wait(wait_s):  # else the process may already work for the next job
            self._worker.kill()

    def _work(self) -> None:
        self._prepare()
        while True:
            try:
                job = self._accepted.get(timeout=START_CHECK_S if self._worker.starting else IDLE_CHECK_S)
            except queue.Empty:
                self._prepare()  # if recognition has died, a new process is ready for the next scan
                continue
            if job is None:
                return
            job.started.set()
            self._runner.run(job)
            if self._accepted.empty():  # else the next job, which may be cancelled already, prepares it if needed
                self._prepare()

    def _prepare(self) -> None:
        if not self._lock.closed:
            self._worker.prepare()
