"""The lock that admits one job at a time."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cell.errors import CellError
from service.errors import ServiceError
from service.jobs.job import Job

PREPARING_S = 1.0
"""How long a request waits while another one is prepared, so that the refusal can name the job. A scan is accepted
within milliseconds; for a calibration the cell may have to connect first."""
LOCK_S = 0.5
"""Timeout for acquiring the internal lock. It is held for milliseconds, or longer if another program locks the
database: then requests must not queue up behind one another."""


class CellLock:
    """Held from the preparation of a job until its final row is written. Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        """Held while the cell lock is taken or released together with the row of the job. A client that reads a final
        state therefore finds the cell free."""
        self._prepared = threading.Condition(self._lock)
        """Notified when a prepared job is accepted or refused."""
        self._job: Job[Any] | None = None
        self._preparing = False
        """A job is being prepared and is not accepted yet."""
        self._closed = False

    @property
    def job(self) -> Job[Any] | None:
        """The job that is accepted and has not ended."""
        return self._job

    @property
    def closed(self) -> bool:
        """No further job is accepted."""
        return self._closed

    def refuse_more(self) -> None:
        """Accept no further job, except one that is being accepted right now. Does not block."""
        self._closed = True

    def close(self) -> Job[Any] | None:
        """Accept no further job, and return the running one."""
        with self._lock:
            self._closed = True
            return self._job

    def raise_if_occupied(self) -> None:
        """Raise why no job is accepted at present, if so. Does not block.

        Raises:
            ServiceError: `cell-busy`, a job runs or is being prepared; `not-ready`, the service is stopping.
        """
        self._refuse_if_closed()
        if (job := self._job) is not None:
            raise _occupied_by(job)
        if self._preparing:
            raise ServiceError(
                "cell-busy", "something else is being prepared; try again in some seconds", retry_after_s=2.0
            )

    @contextmanager
    def reserved(self) -> Iterator[None]:
        """Reserve the cell while a job is prepared. It is free again at the end, unless the job was accepted.

        Raises:
            ServiceError: `cell-busy`, another job runs or is being prepared; `busy`, the row of another job cannot be
                written at the moment; `not-ready`, the service is stopping.
        """
        latest = time.monotonic() + LOCK_S + PREPARING_S + LOCK_S
        if not self._lock.acquire(timeout=LOCK_S):
            raise _database_busy()
        try:
            self._prepared.wait_for(lambda: self._job is not None or not self._preparing, PREPARING_S)
            if time.monotonic() > latest:  # it took long to acquire the lock again
                raise _database_busy()
            self.raise_if_occupied()
            self._preparing = True
        finally:
            self._lock.release()
        try:
            yield
        except CellError:
            self._refuse_if_closed()  # closing the cell caused the error
            raise
        finally:
            with self._lock:
                self._preparing = False
                self._prepared.notify_all()

    @contextmanager
    def accepting(self, job: Job[Any], begin: Callable[[Job[Any]], None]) -> Iterator[None]:
        """Write the row of `job` in this context. At its end the job has the reserved cell and begins.

        Both happen before the lock can be closed, so a job that is running at that time has begun.

        Raises:
            ServiceError: `not-ready`, the service is stopping.
        """
        with self._lock:
            self._refuse_if_closed()
            yield
            self._job = job
            begin(job)
            self._prepared.notify_all()

    @contextmanager
    def releasing(self, job: Job[Any]) -> Iterator[None]:
        """Write the final row in this context. The cell is free at its end, but not if it raises."""
        with self._lock:
            yield
            if self._job is job:
                self._job = None

    def _refuse_if_closed(self) -> None:
        if self._closed:
            raise ServiceError("not-ready", "the service is stopping")


def _occupied_by(job: Job[Any]) -> ServiceError:
    if job.stop is None:
        detail = f"{job.label} is under way; wait for its end or cancel it"
        return ServiceError("cell-busy", detail, job=job.reference, kind=job.kind, id=job.reference.id)
    detail = f"{job.label} was stopped and is just ending; try again"
    return ServiceError("cell-busy", detail, retry_after_s=1.0, job=job.reference, kind=job.kind, id=job.reference.id)


def _database_busy() -> ServiceError:
    detail = "the database is locked by another program, or the disk is slow; try again"
    return ServiceError("busy", detail, retry_after_s=5.0)
