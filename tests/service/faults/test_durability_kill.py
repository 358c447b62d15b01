"""Fault 20: the service is killed at any moment under load. All acknowledged data survives."""

import os
import random
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.clock import format_utc
from service.integrity.check import check_store, is_service_running
from service.integrity.repair import repair
from service.states import ACTIVE_STATES
from service.storage.database import time_of_id
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.faults.quick_service import RunningService, quick_services
from tests.service.faults.recognition_stub import describe_here
from tests.service.service_process import answers
from tests.service.stored_data import check_target_of

pytestmark = [
    pytest.mark.fault(20),
    pytest.mark.xdist_group("service"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="services are forked"),
]

ALLOWED_FINDINGS = {"leftover", "scan-unfinished", "recording-without-row", "result-without-row"}
"""Findings that a kill may cause: files without a row, and a scan without a final state."""
SERVICES_PER_FOLDER = 25
"""Number of services that run on one data folder, one after the other."""
Document = dict[str, Any]


@dataclass
class Acknowledged:
    """Answers that the services of one data folder gave to clients."""

    recordings: dict[str, Document] = field(default_factory=dict)
    scans: dict[str, Document] = field(default_factory=dict)
    """The last document of each scan."""
    keys: dict[str, tuple[Document, str]] = field(default_factory=dict)
    """Body of the request and id of the scan, by idempotency key."""
    kept: set[str] = field(default_factory=set)


class Clients:
    """Clients that upload recordings, request scans, protect scans and list data until the service is killed."""

    def __init__(self, running: RunningService, content: bytes, acknowledged: Acknowledged, rng: random.Random) -> None:
        self._service, self._content, self._acknowledged = running, content, acknowledged
        self._seeds = [rng.random() for _ in range(4)]
        self._gone = threading.Event()
        self._errors: list[BaseException] = []
        parts = (self._upload, self._replay, self._mark, self._list)
        self._threads = [
            threading.Thread(target=self._until_gone, args=(part, seed), daemon=True)
            for part, seed in zip(parts, self._seeds, strict=True)
        ]
        for thread in self._threads:
            thread.start()

    def join(self) -> None:
        """Wait for the end of the clients after the kill. Raise an unexpected error of a client."""
        self._gone.set()
        for thread in self._threads:
            thread.join(timeout=60)
            assert not thread.is_alive()
        for error in self._errors:
            raise error

    def _until_gone(self, part: Callable[[httpx2.Client, random.Random], None], seed: float) -> None:
        rng = random.Random(seed)
        try:
            with httpx2.Client(base_url=f"http://127.0.0.1:{self._service.port}", timeout=30) as client:
                while not self._gone.is_set():
                    part(client, rng)
        except httpx2.TransportError:
            pass  # it was killed
        except BaseException as error:  # noqa: BLE001 (raised by `join`)
            self._errors.append(error)

    def _upload(self, client: httpx2.Client, rng: random.Random) -> None:
        answer = client.post("/api/recordings", content=self._content)
        assert answer.status_code == 201, answer.text
        self._acknowledged.recordings[answer.json()["id"]] = answer.json()

    def _replay(self, client: httpx2.Client, rng: random.Random) -> None:
        if not self._acknowledged.recordings:
            time.sleep(0.01)
            return
        key = f"key {rng.random()}"
        body = {"mode": "replay", "recording": rng.choice(list(self._acknowledged.recordings)[-3:])}
        answer = client.post("/api/scans", json=body, headers={"Idempotency-Key": key})
        if answer.status_code in (404, 409):  # retention removed it, or a live scan is active
            time.sleep(0.01)
            return
        assert answer.status_code == 202, answer.text
        scan = answer.json()
        self._acknowledged.scans[scan["id"]] = scan
        self._acknowledged.keys[key] = (body, scan["id"])
        while scan["state"] in ACTIVE_STATES:
            answer = client.get(scan["links"]["self"])
            if answer.status_code == 404:  # ended and removed
                return
            scan = answer.json()
        self._acknowledged.scans[scan["id"]] = scan
        assert scan["state"] == "succeeded", scan

    def _mark(self, client: httpx2.Client, rng: random.Random) -> None:
        time.sleep(0.02)
        ended = [name for name, scan in list(self._acknowledged.scans.items()) if scan["state"] not in ACTIVE_STATES]
        if ended and len(self._acknowledged.kept) < 10:
            name = rng.choice(ended)
            if client.put(f"/api/scans/{name}/keep", json={"kept": True}).status_code == 200:
                self._acknowledged.kept.add(name)

    def _list(self, client: httpx2.Client, rng: random.Random) -> None:
        time.sleep(0.02)
        for kind in ("scans", "recordings"):
            listed = [one["id"] for one in client.get(f"/api/{kind}?limit=50").json()[kind]]
            assert listed == sorted(listed, reverse=True)


def assert_present(client: httpx2.Client, acknowledged: Acknowledged, retention: bool) -> None:
    """Assert that all acknowledged data exists. With `retention`, unprotected data may be removed completely."""

    def get(kind: str, name: str, needed: bool) -> Document | None:
        answer = client.get(f"/api/{kind}/{name}")
        if answer.status_code == 404 and retention and not needed:
            return None
        assert answer.status_code == 200, answer.text
        return answer.json()

    for name, recording in acknowledged.recordings.items():
        found = get("recordings", name, needed=False)
        if retention and found is not None and found["created_at"] != recording["created_at"]:
            # It was being removed when the service was killed, and the repair has adopted its file again.
            begin = time_of_id(name)
            assert begin is not None
            assert found == recording | {"created_at": format_utc(begin)}
        else:
            assert found in (None, recording)
    for name, before in acknowledged.scans.items():
        scan = get("scans", name, needed=name in acknowledged.kept)
        if scan is None:
            continue
        assert scan["state"] not in ACTIVE_STATES
        assert scan["kept"] or name not in acknowledged.kept
        if before["state"] in ACTIVE_STATES:
            assert scan["state"] in ("interrupted", "succeeded")
        else:
            assert scan | {"kept": None} == before | {"kept": None}
        if name in acknowledged.kept:
            assert client.get(scan["links"]["recording"]).status_code == 200
    for key, (body, name) in list(acknowledged.keys.items())[-5:]:
        if client.get(f"/api/scans/{name}").status_code == 200:
            again = client.post("/api/scans", json=body, headers={"Idempotency-Key": key})
            if retention and client.get(f"/api/scans/{name}").status_code == 404:  # retention has removed it meanwhile
                continue
            assert (again.status_code, again.json()["id"]) == (202, name)
            assert again.headers["Idempotency-Replayed"] == "true"


@pytest.mark.parametrize(
    ("lives", "live_every"),
    [
        pytest.param(4, 0, id="some"),
        pytest.param(1000, 25, marks=[pytest.mark.soak, pytest.mark.timeout(7200)], id="thousand"),
    ],
)
def test_acknowledged_data_survives_a_kill(
    recording_file: Path, tmp_path: Path, lives: int, live_every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.integrity.repair.describe_untrusted_recording", describe_here)
    rng, content = random.Random(20), recording_file.read_bytes()
    folders = [range(first, min(first + SERVICES_PER_FOLDER, lives)) for first in range(0, lives, SERVICES_PER_FOLDER)]
    with quick_services(recording_file, tmp_path / "services.log") as services:
        for folder in folders:
            data, acknowledged, retention = tmp_path / f"data-{folder.start}", Acknowledged(), folder.start % 2 == 1
            for number in folder:
                moving = live_every > 0 and number % live_every == live_every - 1
                running = services.start(data, retention=retention, host=free_host() if moving else "-")
                with httpx2.Client(base_url=f"http://127.0.0.1:{running.port}", timeout=60) as client:
                    wait_until(lambda client=client: answers(client))
                    assert_present(client, acknowledged, retention)
                    scan = start_live(client, acknowledged) if moving else None
                clients = Clients(running, content, acknowledged, rng)
                time.sleep(rng.uniform(1, 6) if scan else rng.uniform(0.2, 2.0))
                os.kill(running.pid, signal.SIGKILL)
                clients.join()
                wait_until(lambda data=data: not is_service_running(data))
                found = {finding.code for finding in check_store(check_target_of(data), running=False).findings}
                assert found <= ALLOWED_FINDINGS, found
            assert acknowledged.scans
            assert repair(check_target_of(data), lambda _: None).findings == ()
            running = services.start(data, retention=retention)
            with httpx2.Client(base_url=f"http://127.0.0.1:{running.port}", timeout=60) as client:
                wait_until(lambda client=client: answers(client))
                assert_present(client, acknowledged, retention)
            os.kill(running.pid, signal.SIGKILL)


def start_live(client: httpx2.Client, acknowledged: Acknowledged) -> str:
    """Start a live scan and return its id."""
    answer = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042, "views": 4})
    assert answer.status_code == 202, answer.text
    acknowledged.scans[answer.json()["id"]] = answer.json()
    return answer.json()["id"]
