"""What is asked for most has threads of its own, and says what FastAPI would have said."""

import threading
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from service.schemas import ScanList
from service.store import Store
from tests.service.conftest import PATIENCE_S, wait_until

SHARED_THREADS = 40
"""Starlette's, of all plain routes together."""


def test_answers_come_while_all_other_threads_are_held(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    held, go_on = threading.Semaphore(0), threading.Event()

    def hold(*_: object) -> list[object]:
        held.release()
        assert go_on.wait(PATIENCE_S)
        return []

    with ThreadPoolExecutor(SHARED_THREADS) as pool, monkeypatch.context() as patched:
        patched.setattr(Store, "recordings", hold)
        waiting = [pool.submit(client.get, "/api/recordings") for _ in range(SHARED_THREADS)]
        try:
            for _ in range(SHARED_THREADS):
                assert held.acquire(timeout=PATIENCE_S)
            assert ScanList.model_validate_json(client.get("/api/scans").content).next is None
            assert client.get("/api/cell").json()["state"] == "not_ready"
        finally:
            go_on.set()
        wait_until(lambda: all(one.done() for one in waiting))
    assert {one.result().status_code for one in waiting} == {200}


def test_what_goes_wrong_in_them_is_told_as_elsewhere(client: httpx.Client) -> None:
    answer = client.get("/api/scans/none")
    assert (answer.status_code, answer.json()["type"]) == (404, "urn:pointchain:scan-not-found")
    assert client.get("/api/scans/none/model").status_code == 404
    assert client.get("/api/scans").headers["content-type"] == "application/json"
