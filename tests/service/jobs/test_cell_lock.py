"""The cell lock: one job at a time, the content of a refusal, and closing without losing a job."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from calibration.target.board import Board
from cell.errors import CameraUnreachableError
from recognition.request import RecognitionRequest
from service.errors import JobKind, JobReference, ServiceError
from service.jobs.cell_lock import CellLock
from service.jobs.job import Job
from service.jobs.submission import NOBODY, new_calibration, new_scan


def scan() -> Job:
    return Job(new_scan("replay", RecognitionRequest(), NOBODY, recording="r1"), None)


def calibration() -> Job:
    return Job(new_calibration("calibration", Board(), 15), None)


def refusal(lock: CellLock) -> ServiceError:
    with pytest.raises(ServiceError) as refused, lock.reserved():
        pass
    return refused.value


@pytest.mark.parametrize(("job", "kind"), [(scan(), "scan"), (calibration(), "calibration")])
def test_a_second_request_is_refused_with_the_running_job(
    job: Job, kind: JobKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.cell_lock.PREPARING_S", 0.01)
    lock, done = CellLock(), []
    with lock.reserved():
        error = refusal(lock)
        assert (error.slug, error.retry_after_s, error.job) == ("cell-busy", 2.0, None)
        with lock.accepting(job, lambda begun: done.append(begun.label)):
            done.append("written")
    assert done == ["written", job.label]
    assert lock.job is job
    error = refusal(lock)
    assert (error.retry_after_s, error.job) == (None, JobReference(kind, job.row.id))
    assert job.label in str(error)
    assert job.request_stop("aborted", "it was stopped")
    error = refusal(lock)
    assert (error.retry_after_s, error.job) == (1.0, job.reference)
    assert f"{job.label} was stopped and is just ending" in str(error)
    with lock.releasing(job):
        assert lock.job is job
    assert lock.job is None
    with lock.reserved():
        pass


def test_a_request_during_a_preparation_waits_for_the_name_of_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.jobs.cell_lock.PREPARING_S", 60.0)
    lock, job = CellLock(), scan()
    with ThreadPoolExecutor(1) as pool:
        with lock.reserved():
            second = pool.submit(refusal, lock)
            with lock.accepting(job, lambda _: None):
                pass
        assert second.result().job == job.reference


def test_a_failed_write_leaves_the_lock_free() -> None:
    lock, begun = CellLock(), []
    with pytest.raises(OSError, match="no space"), lock.reserved(), lock.accepting(scan(), begun.append):
        raise OSError("no space")
    assert (lock.job, begun) == (None, [])
    with lock.reserved():
        pass


def test_a_closed_lock_accepts_no_job() -> None:
    lock, written = CellLock(), []

    def prepare() -> None:
        with lock.reserved():
            assert lock.close() is None
            with lock.accepting(scan(), lambda _: None):
                written.append(1)

    with pytest.raises(ServiceError) as refused:
        prepare()
    assert refused.value.slug == "not-ready"
    assert (written, lock.job, lock.closed, refusal(lock).slug) == ([], None, True, "not-ready")


def test_a_cell_error_during_closing_is_reported_as_not_ready() -> None:
    lock = CellLock()

    def prepare() -> None:
        lock.close()
        raise CameraUnreachableError("connecting the camera was given up")

    with pytest.raises(ServiceError) as refused, lock.reserved():
        prepare()
    assert refused.value.slug == "not-ready"
    open_lock = CellLock()
    with pytest.raises(CameraUnreachableError), open_lock.reserved():
        raise CameraUnreachableError("there is none")
    with open_lock.reserved():
        pass


def test_close_returns_the_running_job_and_releasing_another_has_no_effect() -> None:
    lock, first, second = CellLock(), scan(), calibration()
    with lock.reserved(), lock.accepting(first, lambda _: None):
        pass
    with lock.releasing(second):
        pass
    assert lock.close() is first
