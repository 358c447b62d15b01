"""Reprocessing the recording of a scan that ended in any state."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.api.idempotency_header import body_hash
from service.api.schemas.scans import LiveScanRequest
from service.jobs.submission import Requester, new_scan
from service.storage.data_folder import DataFolder
from service.storage.idempotency_keys import Key
from service.storage.store import Store
from tests.service.conftest import Serve, ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.mark.problem("damaged")
def test_a_damaged_recording_is_not_reprocessed(
    client: ServedClient, recording: str, finished: Finished, assert_problem: AssertProblem
) -> None:
    body = {"mode": "replay", "recording": recording}
    scan = finished(client, client.post("/api/scans", json=body).headers["Location"])
    file: Path = client.app.state.context.store.folder.recording(recording)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    try:
        assert_problem(client.post(scan["links"]["reprocess"]), 500, "damaged")
        assert_problem(client.post("/api/scans", json=body), 500, "damaged")
    finally:
        file.write_bytes(whole)


def test_omitted_members_are_as_in_the_first_scan(
    client: httpx2.Client, recording: str, finished: Finished, assert_problem: AssertProblem, held: int
) -> None:
    body = {"mode": "replay", "recording": recording, "string_radius_m": 0.005, "method": "matching"}
    first = client.post("/api/scans", json=body).headers["Location"]
    scan = client.get(first).json()
    assert (scan["links"]["reprocess"], scan["links"]["source"]) == (None, None)
    assert_problem(client.post(f"{first}/reprocess"), 409, "result-not-ready")
    os.kill(held, signal.SIGCONT)
    source = finished(client, first)
    address = source["links"]["reprocess"]

    same = client.post(address, headers={"Idempotency-Key": "reprocess"})
    assert same.status_code == 202, same.text
    again = finished(client, same.headers["Location"])
    assert (again["mode"], again["source"], again["recording"]) == ("replay", source["id"], recording)
    assert (again["method"], again["string_radius_m"]) == ("matching", 0.005)
    assert again["links"]["source"] == first
    assert again["summary"] == source["summary"]
    repeated = client.post(address, json={}, headers={"Idempotency-Key": "reprocess"})
    assert (repeated.json()["id"], repeated.headers["Idempotency-Replayed"]) == (again["id"], "true")
    elsewhere = client.post("/api/scans", json=body, headers={"Idempotency-Key": "reprocess"})
    assert_problem(elsewhere, 422, "idempotency-mismatch")

    # the recording has 4.2 mm; null means that the radius is measured
    measured = client.post(address, json={"string_radius_m": None, "method": "graph"})
    done = finished(client, measured.headers["Location"])
    assert (done["state"], done["string_radius_m"], done["method"]) == ("succeeded", None, "graph")
    (chain,) = client.get(done["links"]["model"]).json()["chains"]
    assert chain["radius_m"] == pytest.approx(0.0042, rel=0.05)
    assert chain["radius_m"] != 0.0042
    assert [found["id"] for found in client.get("/api/scans", params={"source": source["id"]}).json()["scans"]] == [
        done["id"],
        again["id"],
    ]


@pytest.mark.parametrize(
    ("body", "slug"),
    [
        ({"string_radius_m": 1.0}, "invalid-parameters"),
        ({"method": "magic"}, "invalid-request"),
        ({"recording": "r"}, "invalid-request"),
    ],
)
def test_an_invalid_request_is_refused(
    *,
    client: httpx2.Client,
    recording: str,
    finished: Finished,
    assert_problem: AssertProblem,
    body: dict[str, Any],
    slug: str,
) -> None:
    scans = client.get("/api/scans?state=succeeded&limit=1").json()["scans"]
    if not scans:
        started = client.post("/api/scans", json={"mode": "replay", "recording": recording})
        scans = [finished(client, started.headers["Location"])]
    assert_problem(client.post(scans[0]["links"]["reprocess"], json=body), 422, slug)


@pytest.fixture
def killed_service(serve: Serve, recording_file: Path, tmp_path: Path) -> Iterator[tuple[ServedClient, list[str]]]:
    """Start a service after a kill during a live scan, and before the first view of another."""
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        requester = Requester(None, Key("local", "of yesterday", body_hash("/api/scans", LiveScanRequest(mode="live"))))
        scans = [
            replace(new_scan("live", RecognitionRequest(radius_m=0.0042), requester), state="scanning")
            for _ in range(2)
        ]
        store.scans.add(scans[0], requester.key_row(scans[0]))
        store.scans.add(scans[1])
        for index, state in enumerate(("recorded", "recorded", "moving")):
            store.scans.set_view(scans[0].id, index, state)  # type: ignore[arg-type] (one of a list)
        store.scans.set_view(scans[0].id, 3, "missing", "out of the arm's reach")
        content = recording_file.read_bytes()
        folder.recording(scans[0].id).write_bytes(content[: len(content) * 3 // 4])
    with serve(tmp_path) as client:
        yield client, [f"/api/scans/{scan.id}" for scan in scans]


def test_an_interrupted_scan_is_reprocessed_from_its_views(
    killed_service: tuple[ServedClient, list[str]], finished: Finished, assert_problem: AssertProblem
) -> None:
    client, (cut, bare) = killed_service
    scan = client.get(cut).json()
    assert scan["state"] == "interrupted"
    assert "can be reprocessed" in scan["problem"]["detail"]
    missing = client.get(f"/api/recordings/{scan['recording']}").json()["missing"]
    assert "view 3 is missing: out of the arm's reach" in missing
    again = finished(client, client.post(scan["links"]["reprocess"]).headers["Location"])
    assert again["state"] == "partial"
    findings = client.get(again["links"]["model"]).json()["quality"]["findings"]
    notes = [(found["severity"], found["message"]) for found in findings if found["code"] == "recording-incomplete"]
    assert set(notes) >= {("note", message) for message in missing}
    assert again["summary"]["note_count"] >= len(missing)
    assert client.get(cut).json() == scan  # unchanged
    # a client that never got its answer does not start another scan
    lost = client.post("/api/scans", json={"mode": "live"}, headers={"Idempotency-Key": "of yesterday"})
    assert (lost.status_code, lost.headers["Idempotency-Replayed"], lost.json()) == (202, "true", scan)

    empty = client.get(bare).json()
    assert (empty["state"], empty["links"]["reprocess"]) == ("interrupted", None)
    assert_problem(client.post(f"{bare}/reprocess"), 404, "no-result")
    assert_problem(client.post("/api/scans/none/reprocess"), 404, "scan-not-found")
