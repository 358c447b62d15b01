"""Failures of disk, database and program become problem documents."""

import errno
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import httpx2
import pytest

from cell.control.cell import Cell
from cell.errors import TooEarlyError
from service.api.routes import console
from service.storage.scan_store import ScanStore

Serve = Callable[..., AbstractContextManager[httpx2.Client]]
AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def own(serve: Serve, data: Path) -> Iterator[httpx2.Client]:
    # a locked database fails at once
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("service.storage.database.BUSY_S", 0.0)
        with serve(data) as client:
            yield client


def failing(error: Exception) -> Callable[..., None]:
    def fail(*args: object) -> None:
        raise error

    return fail


def test_a_full_disk_is_reported_and_leaves_no_file(
    own: httpx2.Client,
    data: Path,
    recording_file: Path,
    assert_problem: AssertProblem,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    full = OSError(errno.ENOSPC, "No space left on device")
    files, listed = set(data.rglob("*")), own.get("/api/recordings").json()
    for function in ("service.api.routes.recordings.os.fsync", "service.storage.store.sync_folder"):
        with monkeypatch.context() as patch:
            patch.setattr(function, failing(full))
            answer = own.post("/api/recordings", content=recording_file.read_bytes())
        assert_problem(answer, 507, "storage-full")
    assert set(data.rglob("*")) == files
    assert own.get("/api/recordings").json() == listed


def test_a_database_that_another_program_holds_is_busy(
    own: httpx2.Client,
    data: Path,
    recording_file: Path,
    assert_problem: AssertProblem,
) -> None:
    holder = sqlite3.connect(data / "pointchain.sqlite3", isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    try:
        answer = own.post("/api/recordings", content=recording_file.read_bytes())
        assert_problem(answer, 503, "busy")
        assert int(answer.headers["retry-after"]) > 0
        # reading still works
        assert own.get("/api/recordings").status_code == 200
    finally:
        holder.execute("ROLLBACK")
        holder.close()
    assert own.post("/api/recordings", content=recording_file.read_bytes()).status_code == 201


def test_a_too_early_request_has_a_retry_after(
    own: httpx2.Client, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cell, "acknowledge", failing(TooEarlyError("try again in 3.2 s", 3.2)))
    answer = own.post("/api/cell/acknowledge")
    assert assert_problem(answer, 409, "too-early") == "try again in 3.2 s"
    assert answer.headers["Retry-After"] == "4"  # whole seconds, rounded up


@pytest.mark.problem("internal")
def test_an_unexpected_error_is_logged_and_not_sent(
    own: httpx2.Client,
    assert_problem: AssertProblem,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(ScanStore, "newest", failing(RuntimeError("the secret reason")))
    answer = own.get("/api/scans")
    assert "secret" not in assert_problem(answer, 500, "internal")
    # the log is written after the answer
    while not any("secret" in str(record.exc_info) for record in caplog.records):
        time.sleep(0.01)


@pytest.mark.problem("http-error")
def test_a_file_without_permission_is_an_error_of_the_framework(
    own: httpx2.Client, monkeypatch: pytest.MonkeyPatch, assert_problem: AssertProblem
) -> None:
    def refuse(_: str) -> None:
        raise PermissionError

    monkeypatch.setattr(console.FILES, "config_checked", True)  # the console may not be built
    monkeypatch.setattr(console.FILES, "lookup_path", refuse)
    assert_problem(own.get("/console/main.js"), 400, "http-error")


@pytest.mark.problem("not-ready")
def test_a_service_that_cannot_run_a_scan_is_not_ready(
    own: httpx2.Client, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.manager.Jobs.not_ready", "recognition did not start: no libGL")
    assert "libGL" in assert_problem(own.get("/readyz"), 503, "not-ready")
    assert own.get("/healthz").status_code == 200


@pytest.mark.parametrize(
    ("body", "where", "what"),
    [
        ({}, "body.mode", "it is missing"),
        ({"recording": "x"}, "body.mode", "it is missing"),
        ({"mode": "film"}, "body.mode", "'film' is not possible"),
        ({"mode": None}, "body.mode", "'None' is not possible"),
        ({"mode": "replay"}, "body.recording", "it is missing"),
        ({"mode": "live", "radius": 0.004}, "body.radius", "there is no such member"),
        ({"mode": "live", "recording": "x"}, "body.recording", "only a scan with the mode replay"),
        ({"mode": "replay", "recording": "x", "views": 4}, "body.views", "only a scan with the mode live"),
        ({"mode": "live", "views": "many"}, "body.views", 'a whole number from 1 to 32 or "auto" is needed'),
        ({"mode": "live", "views": "8"}, "body.views", 'a whole number from 1 to 32 or "auto" is needed'),
        ({"mode": "live", "views": True}, "body.views", 'a whole number from 1 to 32 or "auto" is needed'),
        ({"mode": "live", "views": 33}, "body.views", 'a whole number from 1 to 32 or "auto" is needed'),
        ({"mode": "live", "string_radius_m": "4 mm"}, "body.string_radius_m", "a number is needed"),
        ({"mode": "live", "all_grasps": "yes"}, "body.all_grasps", "true or false is needed"),
        ([], "body", "a JSON object is needed"),
        ("live", "body", "a JSON object is needed"),
    ],
)
@pytest.mark.problem("invalid-request")
def test_a_scan_of_no_known_kind_is_refused_in_plain_words(
    own: httpx2.Client, assert_problem: AssertProblem, body: object, where: str, what: str
) -> None:
    answer = own.post("/api/scans", json=body)
    detail = assert_problem(answer, 422, "invalid-request")
    (error,) = answer.json()["errors"]
    assert error["where"] == where
    assert error["what"].startswith(what)
    assert detail == f"{where}: {error['what']}"
    assert ('"live" for a scan by the arm' in detail) == (where == "body.mode")
