"""What else is asked for waits until the stop is answered; but not for long, and no other stop does."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import httpx
import pytest

from service.jobs.manager import Jobs
from tests.service.conftest import PATIENCE_S

MOMENT_S = 0.3
"""So long nothing happens that is not to happen."""


@contextmanager
def held_stops(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Semaphore]:
    """While this lasts no stop is answered; the semaphore counts those that have come as far as the arm."""
    come, go_on = threading.Semaphore(0), threading.Event()

    def held(*_: object) -> None:
        come.release()
        assert go_on.wait(PATIENCE_S)

    with monkeypatch.context() as patched:
        patched.setattr(Jobs, "stop_arm", held)
        try:
            yield come
        finally:
            go_on.set()


def test_others_wait_for_the_stop_and_stops_do_not(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.stop_priority.HOLD_S", PATIENCE_S)
    with ThreadPoolExecutor() as pool:
        with held_stops(monkeypatch) as come:
            stops = [pool.submit(client.post, "/api/cell/stop")]
            assert come.acquire(timeout=PATIENCE_S)
            others = [pool.submit(client.get, path) for path in ("/api/cell", "/api/scans", "/healthz")]
            stops.append(pool.submit(client.post, "/api/cell/stop"))
            assert come.acquire(timeout=PATIENCE_S), "a second one does not wait for the first"
            assert not wait(others, MOMENT_S).done
        assert [answer.result(PATIENCE_S).status_code for answer in (*stops, *others)] == [200] * 5


def test_a_stop_that_takes_long_holds_nobody_up(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    with ThreadPoolExecutor() as pool, held_stops(monkeypatch) as come:
        stop = pool.submit(client.post, "/api/cell/stop")
        assert come.acquire(timeout=PATIENCE_S)
        assert client.get("/api/cell").status_code == 200
        assert not stop.done()


def test_behind_a_stop_that_failed_nobody_waits(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("service.api.stop_priority.HOLD_S", 10 * PATIENCE_S)
    with monkeypatch.context() as patched:
        patched.setattr(Jobs, "stop_arm", fail)
        assert client.post("/api/cell/stop").status_code == 500
    assert client.get("/api/cell").status_code == 200
