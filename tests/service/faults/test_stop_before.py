"""What was asked for before a stop moves nothing behind it, wherever it waits, and however often it is sent again."""

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
from tests.service.faults.moves import now_in, seen
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

STOPPED = "urn:pointchain:stopped"


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Each test leaves it able to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


class Gate:
    """Where a method of ours is held until it is let go; nothing else of it is changed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: object, name: str, *, hold: bool = True) -> None:
        self.come, self.go_on = threading.Semaphore(0), threading.Event()
        method = getattr(owner, name)
        if not hold:
            self.go_on.set()

        def held(*arguments: Any, **named: Any) -> Any:
            self.come.release()
            assert self.go_on.wait(PATIENCE_S)
            return method(*arguments, **named)

        monkeypatch.setattr(owner, name, held)

    def wait_for_one(self) -> None:
        assert self.come.acquire(timeout=PATIENCE_S)


@contextmanager
def one_being_planned_and_one_waiting(
    cell: LiveCell, monkeypatch: pytest.MonkeyPatch, **named: Any
) -> Iterator[tuple[Future[httpx2.Response], Future[httpx2.Response]]]:
    """Two live scans are asked for, the first with what `named` says; both are decided on behind the body."""
    monkeypatch.setattr("service.jobs.cell_lock.PREPARING_S", PATIENCE_S)
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patched:
        planning, asking = Gate(patched, Preparation, "plan_scan"), Gate(patched, Submissions, "live", hold=False)
        try:
            first = pool.submit(cell.client.post, "/api/scans", json=SCAN, **named)
            asking.wait_for_one()
            planning.wait_for_one()
            second = pool.submit(cell.client.post, "/api/scans", json=SCAN)
            asking.wait_for_one()
            yield first, second
        finally:
            planning.go_on.set()


def again(cell: LiveCell, key: str) -> httpx2.Response:
    return cell.client.post("/api/scans", json=SCAN | {"views": 2}, headers={"Idempotency-Key": key})


def assert_refused(answer: httpx2.Response) -> None:
    assert (answer.status_code, answer.json()["type"]) == (409, STOPPED), answer.text


def test_whoever_waited_for_the_place_when_the_arm_was_stopped_does_not_get_it(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin = now_in(cell)
    with one_being_planned_and_one_waiting(cell, monkeypatch) as answers:
        assert cell.client.post("/api/cell/stop").status_code == 200
    for answer in answers:
        assert_refused(answer.result(PATIENCE_S))
    assert seen(cell, begin, "motion_start") == []
    assert cell.state()["problem"] == STOPPED
    assert finished(cell.client, cell.start(views=2))["state"] == "succeeded"  # one that is asked for behind it moves


def test_whoever_waits_for_the_arm_to_come_home_does_not_get_it_behind_a_stop(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patched:
        way_home, releasing = Gate(patched, cell_module, "return_home"), Gate(patched, Cell, "release", hold=False)
        try:
            assert finished(cell.client, cell.start(views=4))["state"] == "succeeded"
            way_home.wait_for_one()
            released = pool.submit(cell.client.post, "/api/cell/release")
            releasing.wait_for_one()
            begin = now_in(cell)
            stopped = pool.submit(cell.client.post, "/api/cell/stop")
            wait_until(lambda: bool(stops(seen(cell, begin))))
        finally:
            way_home.go_on.set()
        assert stopped.result(PATIENCE_S).json()["problem"] == STOPPED
    assert_refused(released.result(PATIENCE_S))
    assert cell.state()["problem"] == STOPPED, "it is still told"
    assert cell.client.post("/api/cell/release").status_code == 200  # whoever asks behind it knows
    cell.is_well()


def test_a_wish_from_before_the_stop_is_none_behind_it_when_it_is_sent_again(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin = now_in(cell)
    with one_being_planned_and_one_waiting(cell, monkeypatch, headers={"Idempotency-Key": "k"}) as (first, _):
        assert cell.client.post("/api/cell/stop").status_code == 200
    assert_refused(first.result(PATIENCE_S))
    refused = again(cell, "k")
    assert_refused(refused)
    assert "needs a new Idempotency-Key" in refused.json()["detail"]
    cell.is_well()
    assert_refused(again(cell, "k"))
    assert cell.state()["state"] == "ready", "whoever has connected since has what he asked for"
    assert seen(cell, begin, "motion_start") == []
    answer = again(cell, "another")
    assert answer.status_code == 202, answer.text
    finished(cell.client, answer.headers["Location"])


def test_who_was_told_to_come_again_may_when_nobody_stopped_the_arm_but_for_another(
    cell: LiveCell, finished: Finished
) -> None:
    cell.is_well()
    location = cell.start()
    assert again(cell, "bob").json()["type"] == "urn:pointchain:cell-busy"
    assert cell.client.post(f"{location}/cancel").json()["state"] == "aborted"
    jobs = cell.client.app.state.context.jobs
    jobs.stop_unattended()  # the loop hangs, and nothing moves
    answer = again(cell, "bob")
    assert answer.status_code == 202, answer.text
    assert finished(cell.client, answer.headers["Location"])["state"] == "succeeded"


def test_what_waited_unread_on_its_connection_was_asked_for_before_the_stop(
    cell: LiveCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin, body = now_in(cell), json.dumps(SCAN | {"views": 2})
    scan = (
        f"POST /api/scans HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n{body}"
    )
    end = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with (
        socket.create_connection((cell.client.base_url.host, cell.client.base_url.port), PATIENCE_S) as connection,
        monkeypatch.context() as patched,
    ):
        planning = Gate(patched, Preparation, "plan_scan")
        try:
            connection.sendall(f"{scan}{scan}{end}".encode())
            planning.wait_for_one()
            assert cell.client.post("/api/cell/stop").status_code == 200
        finally:
            planning.go_on.set()
        answers = b"".join(iter(lambda: connection.recv(65536), b"")).decode()
    assert (answers.count("HTTP/1.1 409 "), answers.count(STOPPED), answers.count("HTTP/1.1 200 ")) == (2, 2, 1), (
        answers
    )
    assert seen(cell, begin, "motion_start") == []


def test_a_hanging_loop_lets_nothing_begin_that_was_accepted(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin, jobs = now_in(cell), cell.client.app.state.context.jobs
    with monkeypatch.context() as patched:
        starting = Gate(patched, RecognitionWorker, "start")  # as long as a new process takes
        try:
            location = cell.start()
            starting.wait_for_one()
            jobs.stop_unattended()
        finally:
            starting.go_on.set()
    scan = finished(cell.client, location)
    assert scan["state"] == "aborted"
    assert "did not answer" in scan["problem"]["detail"]
    assert seen(cell, begin, "motion_start") == []


def test_a_hanging_loop_lets_nothing_begin_that_is_being_prepared(
    cell: LiveCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()
    begin, jobs = now_in(cell), cell.client.app.state.context.jobs
    assert isinstance(jobs, Jobs)
    with one_being_planned_and_one_waiting(cell, monkeypatch) as answers:
        jobs.stop_unattended()
    for answer in answers:
        assert_refused(answer.result(PATIENCE_S))
    assert seen(cell, begin, "motion_start") == []
    wait_until(lambda: jobs.idle)
