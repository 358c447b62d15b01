"""`DELETE /api/scans/SCAN`: a scan that has ended is removed with its files, and what others use stays."""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.jobs.submission import NOBODY, new_scan
from service.storage.store import Store
from tests.service.api.routes.test_scans import start
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture
def own_scan(client: ServedClient, recording: str, finished: Finished) -> dict[str, Any]:
    """An ended replay that the test may remove."""
    return finished(client, start(client, recording))


def store_of(client: ServedClient) -> Store:
    return client.app.state.context.store


def test_a_removed_scan_is_gone_with_its_results(
    client: ServedClient, own_scan: dict[str, Any], assert_problem: AssertProblem
) -> None:
    address, results = own_scan["links"]["self"], store_of(client).folder.results(own_scan["id"])
    assert own_scan["final"] is True
    assert results.exists()
    answer = client.delete(address)
    assert (answer.status_code, answer.content) == (204, b"")
    assert not results.exists()
    for link in ("self", "model", "events", "views"):
        assert_problem(client.get(own_scan["links"][link]), 404, "scan-not-found")
    assert own_scan["id"] not in [scan["id"] for scan in client.get("/api/scans").json()["scans"]]
    assert_problem(client.delete(address), 404, "scan-not-found")


def test_the_recording_goes_with_its_last_scan(
    client: ServedClient, recording_file: Any, finished: Finished, assert_problem: AssertProblem
) -> None:
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    scans = [finished(client, start(client, recording)) for _ in range(2)]
    address = f"/api/recordings/{recording}"
    assert client.delete(scans[0]["links"]["self"]).status_code == 204
    assert client.get(address).status_code == 200
    assert client.delete(scans[1]["links"]["self"]).status_code == 204
    assert_problem(client.get(address), 404, "recording-not-found")


@pytest.mark.problem("scan-kept")
def test_a_kept_scan_is_not_removed(
    client: ServedClient, own_scan: dict[str, Any], assert_problem: AssertProblem
) -> None:
    address = own_scan["links"]["self"]
    client.put(f"{address}/keep", json={"kept": True})
    assert_problem(client.delete(address), 409, "scan-kept")
    assert client.get(own_scan["links"]["model"]).status_code == 200
    client.put(f"{address}/keep", json={"kept": False})
    assert client.delete(address).status_code == 204


@pytest.mark.problem("scan-active")
def test_a_scan_that_has_not_ended_is_not_removed(
    client: ServedClient, recording: str, assert_problem: AssertProblem
) -> None:
    store = store_of(client)
    scan = new_scan("replay", RecognitionRequest(radius_m=0.0042), NOBODY, recording=recording)
    store.scans.add(scan)
    try:
        document = client.get(f"/api/scans/{scan.id}").json()
        assert (document["state"], document["final"]) == ("queued", False)
        assert "queued" in assert_problem(client.delete(f"/api/scans/{scan.id}"), 409, "scan-active")
        assert store.scans.get(scan.id) == scan
    finally:
        with store.database.transaction() as db:
            db.execute("DELETE FROM events WHERE scan = ?", (scan.id,))
            db.execute("DELETE FROM scans WHERE id = ?", (scan.id,))


def test_a_scan_that_was_reprocessed_stays_readable(
    client: ServedClient, own_scan: dict[str, Any], finished: Finished
) -> None:
    again = finished(client, client.post(own_scan["links"]["reprocess"]).headers["Location"])
    assert client.delete(own_scan["links"]["self"]).status_code == 204
    after = client.get(again["links"]["self"]).json()
    assert (after["source"], after["links"]["source"]) == (None, None)
    assert client.get(after["links"]["model"]).status_code == 200
