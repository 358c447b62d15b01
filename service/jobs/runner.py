"""Runs jobs one after the other, and brings each to its final state."""

import logging
import sqlite3
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack
from typing import Any, Protocol

from cell.errors import CellError, StoppedError
from service.errors import Failure, JobKind
from service.jobs.cell_lock import CellLock
from service.jobs.job import Job
from service.logs.setup import scan_log_context
from service.states import ScanState

log = logging.getLogger(__name__)

RETRY_S = 1.0
"""Interval at which a final row that could not be written is tried again. Requests can come in between."""


class JobCancelledError(Exception):
    """The job was stopped before it began to work."""


class Work(Protocol):
    """What one kind of job does, as steps of `JobRunner`."""

    def describe(self, job: Job[Any]) -> str:
        """Return what the job is about, for the log."""
        ...

    def execute(self, job: Job[Any]) -> AbstractContextManager[Any]:
        """Do the job, and yield its result. The body stores the result while the arm may still return home.

        Raises:
            JobCancelledError: The job was stopped before it began.
            StoppedError: The arm was stopped.
        """
        ...

    def failure_of(self, error: Exception) -> Failure | None:
        """Return why the job failed; None for an error that is unexpected."""
        ...

    def store(self, job: Job[Any], result: Any) -> ScanState:
        """Write the final row of a job that has a result, and return its state."""
        ...

    def end(self, job: Job[Any], state: ScanState, failure: Failure) -> None:
        """Write the final row of a job that has no result."""
        ...

    def unexpected_failure(self, job: Job[Any], error: Exception) -> Failure:
        """Return why a job failed that met an unexpected error, or whose final row could not be written."""
        ...

    def on_end(self, job: Job[Any], state: ScanState, duration_s: float) -> None:
        """Count the job in the metrics."""
        ...

    def finish(self, job: Job[Any], result: Any | None, stored: bool) -> None:
        """Do what follows the final row; `stored` says whether the result was kept."""
        ...


class JobRunner:
    """Runs jobs, in the one thread of `Jobs`."""

    def __init__(self, lock: CellLock, work: Mapping[JobKind, Work]) -> None:
        self._lock, self._work = lock, work

    def run(self, job: Job[Any]) -> None:
        """Bring a job to its final state. On return the arm is home, or has stopped."""
        work, started_at = self._work[job.kind], time.monotonic()
        with scan_log_context(job.row.id if job.kind == "scan" else None):
            log.info("%s begins: %s", job.label, work.describe(job))
            try:
                with ExitStack() as until_home:
                    self._run(job, work, until_home, started_at)
            except CellError as error:
                log.warning("after %s the arm did not return home: %s", job.label, error)
            except Exception as error:  # any error fails this job only
                log.exception("%s could not be recorded", job.label)
                self._fail(job, work, error, started_at)
        job.ended.set()

    def _run(self, job: Job[Any], work: Work, until_home: ExitStack, started_at: float) -> None:
        result, stored = None, False
        try:
            result, failure = _attempt(job, work, until_home)
            self._store(job, work, result, failure, started_at)
            stored = result is not None and job.stop is None
        finally:
            job.ended.set()
            work.finish(job, result, stored)

    def _store(self, job: Job[Any], work: Work, result: Any | None, failure: Failure | None, started_at: float) -> None:
        stop = job.begin_storing()
        with self._lock.releasing(job):
            state: ScanState = "failed"
            if stop is not None:
                state, failure = stop.state, stop.failure
                work.end(job, state, failure)
            elif result is not None:
                state = work.store(job, result)
            else:
                assert failure is not None
                work.end(job, state, failure)
        _report_end(job, work, state, failure, started_at)

    def _fail(self, job: Job[Any], work: Work, error: Exception, started_at: float) -> None:
        """Fail a job after an unexpected error. Its final row is written as soon as disk and database allow it."""
        state: ScanState = "failed"
        failure = work.unexpected_failure(job, error)
        if job.stop is not None:
            state, failure = job.stop.state, job.stop.failure
        _report_end(job, work, state, failure, started_at)
        self._write_until_done(job, work, state, failure)

    def _write_until_done(self, job: Job[Any], work: Work, state: ScanState, failure: Failure) -> None:
        """Write the final row, again and again while the database is locked or the disk is full. No other job begins.

        It gives up when the service is ending, and after an error that does not pass: the next start corrects the row.
        """
        reported = False
        while True:
            try:
                with self._lock.releasing(job):
                    work.end(job, state, failure)
                return
            except sqlite3.OperationalError:  # the database is locked, or the disk is full or fails
                if not reported:
                    log.exception("the end of %s cannot be written; the service tries again", job.label)
                    reported = True
            except sqlite3.Error:
                log.exception("the end of %s cannot be written", job.label)
                break
            if job.shutting_down.wait(RETRY_S):
                break
        with self._lock.releasing(job):
            pass


def _attempt(job: Job[Any], work: Work, until_home: ExitStack) -> tuple[Any | None, Failure | None]:
    """Return the result of a job, or why there is none; neither if the job was stopped."""
    try:
        return until_home.enter_context(work.execute(job)), None
    except JobCancelledError:
        return None, None
    except StoppedError as error:
        job.request_stop("aborted", str(error))  # has no effect if the stop itself gave a reason
        return None, None
    except Exception as error:
        failure = work.failure_of(error)
        if failure is None:
            raise
        return None, failure


def _report_end(job: Job[Any], work: Work, state: ScanState, failure: Failure | None, started_at: float) -> None:
    duration_s = time.monotonic() - started_at
    level = logging.WARNING if state == "failed" else logging.INFO
    log.log(level, "%s %s after %.1f s%s", job.label, state, duration_s, _reason(state, failure))
    work.on_end(job, state, duration_s)


def _reason(state: str, failure: Failure | None) -> str:
    """Return the end of the log line; a slug that is the name of the state is not repeated."""
    if failure is None:
        return ""
    return f": {failure.message}" if failure.slug == state else f": {failure.slug}: {failure.message}"
