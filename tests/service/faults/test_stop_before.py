"""Requests from before a stop cause no motion after it, wherever they wait and however often they are repeated."""

import json
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import httpx2
import pytest

from cell.control import cell as cell_module
from cell.control.cell import Cell
from cell.control.preparation import Preparation
from service.jobs.manager import Jobs
from service.jobs.submission import Submissions
from service.processing.worker import RecognitionWorker
from tests.cell.arm.virtual_arm import stops
from tests.service.conftest import PATIENCE_S, Serve, wait_until
from tests.service.faults.moves import events_since, log_position
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

STOPPED = "urn:pointchain:stopped"


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A live cell. Each test leaves it ready to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


class Gate:
    """Holds the calls of a method until `go_on` is set. With `hold=False` it only counts them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: object, name: str, *, hold: bool = True) -> None:
        self.called, self.go_on = threading.Semaphore(0), threading.Event()
        method = getattr(owner, name)
        if not hold:
            self.go_on.set()

        def held(*arguments: Any, **named: Any) -> Any:
            self.called.release()
            assert self.go_on.wait(PATIENCE_S)
            return method(*arguments, **named)

        monkeypatch.setattr(owner, name, held)

    def wait_for_one(self) -> None:
        """Wait until the method is called."""
        assert self.called.acquire(timeout=PATIENCE_S)


@contextmanager
def one_being_checked_and_one_waiting(
    cell: LiveCell, monkeypatch: pytest.MonkeyPatch, **named: Any
) -> Iterator[tuple[Future[httpx2.Response], Future[httpx2.Response]]]:
    """Request two live scans, the first with the options `named`. Both are decided after the body."""
    monkeypatch.setattr("service.jobs.cell_lock.PREPARING_S", PATIENCE_S)
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patched:
        checking, asking = Gate(patched, Cell, "check_scan"), Gate(patched, Submissions, "live", hold=False)
        try:
            first = pool.submit(cell.client.post, "/api/scans", json=SCAN, **named)
            asking.wait_for_one()
            checking.wait_for_one()
            second = pool.submit(cell.client.post, "/api/scans", json=SCAN)
            asking.wait_for_one()
            yield first, second
        finally:
            checking.go_on.set()


def request_scan(cell: LiveCell, key: str) -> httpx2.Response:
    """Request a live scan with an idempotency key."""
    return cell.client.post("/api/scans", json=SCAN | {"views": 2}, headers={"Idempotency-Key": key})


def assert_refused(answer: httpx2.Response) -> None:
    """Assert that the answer is a refusal because of a stop."""
    assert (answer.status_code, answer.json()["type"]) == (409, STOPPED), answer.text


def test_a_stop_refuses_scans_that_wait_for_the_cell_lock(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin = log_position(cell)
    with one_being_checked_and_one_waiting(cell, monkeypatch) as answers:
        assert cell.client.post("/api/cell/stop").status_code == 200
    for answer in answers:
        assert_refused(answer.result(PATIENCE_S))
    assert events_since(cell, begin, "motion_start") == []
    assert cell.state()["problem"] == STOPPED
    assert finished(cell.client, cell.start(views=2))["state"] == "succeeded"  # a request after the stop moves the arm


@pytest.mark.parametrize("ending", ["stop", "cancel"])
def test_a_scan_that_is_being_planned_ends_without_a_motion(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    cell.is_well()
    begin = log_position(cell)
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patched:
        planning = Gate(patched, Preparation, "plan_scan")
        try:
            accepted = request_scan(cell, f"planned, then {ending}")
            assert (accepted.status_code, accepted.json()["state"]) == (202, "connecting"), accepted.text
            location = accepted.headers["Location"]
            planning.wait_for_one()
            assert request_scan(cell, f"meanwhile, {ending}").json()["type"] == "urn:pointchain:cell-busy"
            address = "/api/cell/stop" if ending == "stop" else f"{location}/cancel"
            ended = pool.submit(cell.client.post, address)
            wait_until(lambda: cell.client.get(location).json()["state"] == "stopping")
        finally:
            planning.go_on.set()
        assert ended.result(PATIENCE_S).status_code == 200
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    assert request_scan(cell, f"planned, then {ending}").json()["id"] == scan["id"]  # a retry starts nothing
    assert events_since(cell, begin, "motion_start") == []


@pytest.mark.problem("stopped")
def test_a_stop_refuses_a_release_that_waits_for_the_move_home(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patched:
        returning, releasing = Gate(patched, cell_module, "return_home"), Gate(patched, Cell, "release", hold=False)
        try:
            assert finished(cell.client, cell.start(views=4))["state"] == "succeeded"
            returning.wait_for_one()
            released = pool.submit(cell.client.post, "/api/cell/release")
            releasing.wait_for_one()
            begin = log_position(cell)
            stopped = pool.submit(cell.client.post, "/api/cell/stop")
            wait_until(lambda: bool(stops(events_since(cell, begin))))
        finally:
            returning.go_on.set()
        assert stopped.result(PATIENCE_S).json()["problem"] == STOPPED
    assert_refused(released.result(PATIENCE_S))
    assert cell.state()["problem"] == STOPPED, "the stop is no longer reported"
    assert cell.client.post("/api/cell/release").status_code == 200  # a request after the stop is accepted
    cell.is_well()


def test_a_request_from_before_a_stop_is_refused_when_repeated(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin = log_position(cell)
    with one_being_checked_and_one_waiting(cell, monkeypatch, headers={"Idempotency-Key": "k"}) as (first, _):
        assert cell.client.post("/api/cell/stop").status_code == 200
    assert_refused(first.result(PATIENCE_S))
    refused = request_scan(cell, "k")
    assert_refused(refused)
    assert "needs a new Idempotency-Key" in refused.json()["detail"]
    cell.is_well()
    assert_refused(request_scan(cell, "k"))
    assert cell.state()["state"] == "ready", "the refused request changed the state of the cell"
    assert events_since(cell, begin, "motion_start") == []
    answer = request_scan(cell, "another")
    assert answer.status_code == 202, answer.text
    finished(cell.client, answer.headers["Location"])


def test_a_retry_after_cell_busy_is_accepted_if_another_scan_was_cancelled(cell: LiveCell, finished: Finished) -> None:
    cell.is_well()
    location = cell.start()
    assert request_scan(cell, "bob").json()["type"] == "urn:pointchain:cell-busy"
    assert cell.client.post(f"{location}/cancel").status_code == 200
    assert finished(cell.client, location)["state"] == "aborted"
    jobs = cell.client.app.state.context.jobs
    jobs.stop_unattended()  # the loop hangs while nothing moves
    answer = request_scan(cell, "bob")
    assert answer.status_code == 202, answer.text
    assert finished(cell.client, answer.headers["Location"])["state"] == "succeeded"


def test_a_stop_refuses_unread_pipelined_requests(cell: LiveCell, monkeypatch: pytest.MonkeyPatch) -> None:
    cell.is_well()
    begin, body = log_position(cell), json.dumps(SCAN | {"views": 2})
    scan = (
        f"POST /api/scans HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n{body}"
    )
    end = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with (
        socket.create_connection((cell.client.base_url.host, cell.client.base_url.port), PATIENCE_S) as connection,
        monkeypatch.context() as patched,
    ):
        checking = Gate(patched, Cell, "check_scan")
        try:
            connection.sendall(f"{scan}{scan}{end}".encode())
            checking.wait_for_one()
            assert cell.client.post("/api/cell/stop").status_code == 200
        finally:
            checking.go_on.set()
        answers = b"".join(iter(lambda: connection.recv(65536), b"")).decode()
    assert (answers.count("HTTP/1.1 409 "), answers.count(STOPPED), answers.count("HTTP/1.1 200 ")) == (2, 2, 1), (
        answers
    )
    assert events_since(cell, begin, "motion_start") == []


def test_a_hanging_event_loop_aborts_an_accepted_scan(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin, jobs = log_position(cell), cell.client.app.state.context.jobs
    with monkeypatch.context() as patched:
        starting = Gate(patched, RecognitionWorker, "start")  # holds the scan as long as a process starts
        try:
            location = cell.start()
            starting.wait_for_one()
            jobs.stop_unattended()
        finally:
            starting.go_on.set()
    scan = finished(cell.client, location)
    assert scan["state"] == "aborted"
    assert "did not answer" in scan["problem"]["detail"]
    assert events_since(cell, begin, "motion_start") == []


def test_a_hanging_event_loop_refuses_scans_that_are_not_accepted(
    cell: LiveCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin, jobs = log_position(cell), cell.client.app.state.context.jobs
    assert isinstance(jobs, Jobs)
    with one_being_checked_and_one_waiting(cell, monkeypatch) as answers:
        jobs.stop_unattended()
    for answer in answers:
        assert_refused(answer.result(PATIENCE_S))
    assert events_since(cell, begin, "motion_start") == []
    wait_until(lambda: jobs.idle)
