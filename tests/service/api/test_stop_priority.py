"""Other requests wait for the answer of a stop, but not for long. Other stops do not wait."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import httpx2
import pytest

from service.jobs.manager import Jobs
from tests.service.conftest import PATIENCE_S

QUIET_S = 0.3
"""Time for which the test watches that no answer comes."""


@contextmanager
def blocked_stops(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Semaphore]:
    """Block all stops. The semaphore counts the stops that have reached the arm."""
    arrived, proceed = threading.Semaphore(0), threading.Event()

    def hold(*_: object) -> None:
        arrived.release()
        assert proceed.wait(PATIENCE_S)

    with monkeypatch.context() as patched:
        patched.setattr(Jobs, "stop_arm", hold)
        try:
            yield arrived
        finally:
            proceed.set()


def test_other_requests_wait_for_a_stop_and_other_stops_do_not(
    client: httpx2.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.api.stop_priority.MAX_WAIT_S", PATIENCE_S)
    with ThreadPoolExecutor() as pool:
        with blocked_stops(monkeypatch) as arrived:
            stops = [pool.submit(client.post, "/api/cell/stop")]
            assert arrived.acquire(timeout=PATIENCE_S)
            others = [pool.submit(client.get, path) for path in ("/api/cell", "/api/scans", "/healthz")]
            stops.append(pool.submit(client.post, "/api/cell/stop"))
            assert arrived.acquire(timeout=PATIENCE_S), "a second stop must not wait for the first"
            assert not wait(others, QUIET_S).done
        assert [answer.result(PATIENCE_S).status_code for answer in (*stops, *others)] == [200] * 5


def test_a_long_stop_does_not_block_other_requests(client: httpx2.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    with ThreadPoolExecutor() as pool, blocked_stops(monkeypatch) as arrived:
        stop = pool.submit(client.post, "/api/cell/stop")
        assert arrived.acquire(timeout=PATIENCE_S)
        assert client.get("/api/cell").status_code == 200
        assert not stop.done()


def test_no_request_waits_after_a_failed_stop(client: httpx2.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("service.api.stop_priority.MAX_WAIT_S", 10 * PATIENCE_S)
    with monkeypatch.context() as patched:
        patched.setattr(Jobs, "stop_arm", fail)
        assert client.post("/api/cell/stop").status_code == 500
    assert client.get("/api/cell").status_code == 200
