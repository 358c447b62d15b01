"""Idempotency keys: a repeated request starts no second scan, and of concurrent requests only one starts a scan."""

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.api.idempotency_header import body_hash
from service.api.schemas.scans import LiveScanRequest, ReprocessRequest
from service.errors import ServiceError
from service.jobs.submission import NOBODY, Requester, new_scan
from service.storage.data_folder import DataFolder
from service.storage.idempotency_keys import REQUEST_MEMORY_S as MEMORY_S
from service.storage.idempotency_keys import IdempotencyKeys, Key
from service.storage.rows import ScanRow
from service.storage.store import Store

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]

REQUESTS = 50


def scan_body(recording: str, **more: Any) -> dict[str, Any]:
    return {"mode": "replay", "recording": recording, **more}


def post(client: httpx2.Client, body: dict[str, Any], key: str | None = None) -> httpx2.Response:
    return client.post("/api/scans", json=body, headers={} if key is None else {"Idempotency-Key": key})


def send_concurrently(send: Callable[[], httpx2.Response]) -> list[httpx2.Response]:
    """Send a request from many threads at once and return the answers."""
    with ThreadPoolExecutor(REQUESTS) as pool:
        return [answer.result() for answer in [pool.submit(send) for _ in range(REQUESTS)]]


def scans_of(client: httpx2.Client, recording: str) -> list[str]:
    """Return the ids of the scans of a recording."""
    return [scan["id"] for scan in client.get("/api/scans", params={"recording": recording}).json()["scans"]]


def test_one_of_many_concurrent_requests_is_accepted_and_named_to_the_others(
    *,
    client: httpx2.Client,
    recording: str,
    held: int,
    finished: Finished,
    assert_problem: AssertProblem,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A busy disk may take long to accept the first request.
    monkeypatch.setattr("service.jobs.cell_lock.PREPARING_S", 60.0)
    answers = send_concurrently(lambda: post(client, scan_body(recording)))
    (accepted,) = [answer for answer in answers if answer.status_code == 202]
    for answer in answers:
        assert answer.headers["Location"] == accepted.headers["Location"]
        if answer is not accepted:
            assert_problem(answer, 409, "cell-busy")
    assert scans_of(client, recording) == [accepted.json()["id"]]
    os.kill(held, signal.SIGCONT)
    finished(client, accepted.headers["Location"])


def test_the_same_key_returns_the_same_scan_in_any_state(
    client: httpx2.Client, recording: str, held: int, finished: Finished, assert_problem: AssertProblem
) -> None:
    def send() -> httpx2.Response:
        return post(client, scan_body(recording), "again")

    first = send_concurrently(send)
    fresh = [answer for answer in first if answer.status_code == 202 and "Idempotency-Replayed" not in answer.headers]
    assert len(fresh) == 1, [answer.text for answer in first]
    location = fresh[0].headers["Location"]
    for answer in first:
        if answer.status_code == 202:
            assert answer.headers["Location"] == location
            assert answer.json()["id"] == fresh[0].json()["id"]
        else:
            assert_problem(answer, 409, "idempotency-pending")
            assert answer.headers["Retry-After"]
    # During this scan, and with another form of the same body.
    busy = client.post(
        "/api/scans",
        content=f'{{ "recording":"{recording}","mode" : "replay"}}',
        headers={"Idempotency-Key": "again", "Content-Type": "application/json"},
    )
    assert (busy.status_code, busy.headers["Idempotency-Replayed"]) == (202, "true"), busy.text
    assert_problem(post(client, scan_body(recording), "another"), 409, "cell-busy")
    detail = assert_problem(post(client, scan_body(recording, method="matching"), "again"), 422, "idempotency-mismatch")
    assert fresh[0].json()["id"] in detail
    assert scans_of(client, recording) == [fresh[0].json()["id"]]
    os.kill(held, signal.SIGCONT)
    done = finished(client, location)
    assert send().json() == done
    # The refused request did not use its key.
    after = post(client, scan_body(recording), "another")
    assert after.status_code == 202
    assert "Idempotency-Replayed" not in after.headers
    assert finished(client, after.headers["Location"])["id"] != done["id"]


def test_a_refused_request_leaves_its_key_free(
    client: httpx2.Client, recording: str, finished: Finished, assert_problem: AssertProblem
) -> None:
    assert_problem(post(client, scan_body("none"), "refused"), 404, "recording-not-found")
    assert_problem(post(client, scan_body(recording, string_radius_m=1.0), "refused"), 422, "invalid-parameters")
    answer = post(client, scan_body(recording), "refused")
    assert answer.status_code == 202, answer.text
    finished(client, answer.headers["Location"])


@pytest.mark.parametrize("key", ["", "x" * 256, "smørrebrød", "a\tb"])
@pytest.mark.problem("idempotency-key")
def test_an_invalid_key_is_refused(client: httpx2.Client, assert_problem: AssertProblem, key: str) -> None:
    headers = {b"Idempotency-Key": key.encode("latin-1")}
    answer = client.post("/api/scans", json=scan_body("none"), headers=headers)
    assert "printable ASCII" in assert_problem(answer, 422, "idempotency-key")


def test_two_keys_in_one_request_are_refused(client: httpx2.Client, assert_problem: AssertProblem) -> None:
    headers = [("Idempotency-Key", "a"), ("Idempotency-Key", "b")]
    assert_problem(client.post("/api/scans", json=scan_body("none"), headers=headers), 422, "idempotency-key")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        yield store


def test_each_caller_has_its_own_keys(store: Store) -> None:
    keys = IdempotencyKeys(store)
    for caller in ("ann", "bob"):
        key = Key(caller, "k", "hash")
        with keys.first_use(key, 7.0) as used:
            assert used == 7.0
            requester = Requester(caller, key)
            scan = new_scan("live", RecognitionRequest(), requester)
            store.scans.add(scan, requester.key_row(scan))
        with keys.first_use(key, 8.0) as used:
            assert isinstance(used, ScanRow)
            assert (used.id, used.requested_by) == (scan.id, caller)


def test_a_request_whose_key_is_pending_is_refused(store: Store) -> None:
    keys, key = IdempotencyKeys(store), Key("ann", "k", "hash")

    def second(other: Key) -> None:
        with keys.first_use(other, 2.0):
            pass

    with keys.first_use(key, 1.0):
        with pytest.raises(ServiceError) as refused:
            second(Key("ann", "k", "of another body"))
        assert (refused.value.slug, refused.value.retry_after_s) == ("idempotency-pending", 1.0)
        second(Key("bob", "k", "hash"))
    second(key)  # the first request started no scan
    assert store.key("ann", "k") is None
    assert new_scan("live", RecognitionRequest(), NOBODY).requested_by is None


def test_a_repeated_request_keeps_the_time_of_its_first_arrival(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.storage.idempotency_keys.MAX_REMEMBERED", 3)
    keys = IdempotencyKeys(store)

    def requested_at(key: str | None, arrived_s: float) -> float | ScanRow:
        with keys.first_use(None if key is None else Key("ann", key, "hash"), arrived_s) as since:
            return since

    assert requested_at("k", 1000.0) == 1000.0
    assert requested_at("k", 1000.0 + MEMORY_S) == 1000.0
    assert requested_at(None, 1001.0 + MEMORY_S) == 1001.0 + MEMORY_S
    assert requested_at("k", 1001.0 + MEMORY_S) == 1001.0 + MEMORY_S, "a repetition this late counts as a new request"
    for key in "abc":
        requested_at(key, 1002.0 + MEMORY_S)
    assert requested_at("k", 1003.0 + MEMORY_S) == 1003.0 + MEMORY_S, "the oldest of too many are removed"
    assert requested_at("c", 1003.0 + MEMORY_S) == 1002.0 + MEMORY_S


def test_the_hash_depends_on_the_path_and_the_values_of_the_body() -> None:
    live = LiveScanRequest(mode="live")
    assert body_hash("/a", live) == body_hash("/a", LiveScanRequest(mode="live"))
    assert body_hash("/a", live) != body_hash("/b", live)
    assert body_hash("/a", live) != body_hash("/a", LiveScanRequest(mode="live", views=5))
    assert body_hash("/a", live) == body_hash("/a", LiveScanRequest(mode="live", views=None, method="graph"))
    assert body_hash("/a", live) != body_hash("/a", LiveScanRequest(mode="live", method="matching"))
    # An omitted member differs from null.
    assert body_hash("/a", ReprocessRequest()) != body_hash("/a", ReprocessRequest(string_radius_m=None))
