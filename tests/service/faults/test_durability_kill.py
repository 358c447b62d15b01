"""Fault 20: the service is killed at any moment, while much is under way. Whatever it has answered for is there."""

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

from service.integrity.check import check_store, is_service_running
from service.integrity.repair import repair
from service.states import ACTIVE_STATES
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.faults.pretended_recognition import describe_here
from tests.service.faults.quick_service import Life, quick_services
from tests.service.service_process import answers
from tests.service.stored_data import check_target_of

pytestmark = [
    pytest.mark.fault(20),
    pytest.mark.xdist_group("cell"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="services are forked"),
]

LEFT = {"leftover", "scan-unfinished", "recording-without-row", "result-without-row"}
"""What a kill may leave: files that no row tells of yet, and a scan that nobody has ended."""
LIVES_OF_A_FOLDER = 25
Document = dict[str, Any]


@dataclass
class Acknowledged:
    """What clients were answered by the services of one data folder."""

    recordings: dict[str, Document] = field(default_factory=dict)
    scans: dict[str, Document] = field(default_factory=dict)
    """As told last."""
    keys: dict[str, tuple[Document, str]] = field(default_factory=dict)
    """By idempotency key, the wish and the scan."""
    kept: set[str] = field(default_factory=set)


class Clients:
    """They send recordings, have them recognised, mark scans and list, until the service is gone."""

    def __init__(self, life: Life, content: bytes, told: Acknowledged, chance: random.Random) -> None:
        self._life, self._content, self._told = life, content, told
        self._seeds = [chance.random() for _ in range(4)]
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
        """Behind the kill. Raises what one of them was surprised by."""
        self._gone.set()
        for thread in self._threads:
            thread.join(timeout=60)
            assert not thread.is_alive()
        for error in self._errors:
            raise error

    def _until_gone(self, part: Callable[[httpx2.Client, random.Random], None], seed: float) -> None:
        chance = random.Random(seed)
        try:
            with httpx2.Client(base_url=f"http://127.0.0.1:{self._life.port}", timeout=30) as client:
                while not self._gone.is_set():
                    part(client, chance)
        except httpx2.TransportError:
            pass  # it was killed
        except BaseException as error:  # noqa: BLE001 (told by `join`)
            self._errors.append(error)

    def _upload(self, client: httpx2.Client, chance: random.Random) -> None:
        answer = client.post("/api/recordings", content=self._content)
        assert answer.status_code == 201, answer.text
        self._told.recordings[answer.json()["id"]] = answer.json()

    def _replay(self, client: httpx2.Client, chance: random.Random) -> None:
        if not self._told.recordings:
            time.sleep(0.01)
            return
        key = f"key {chance.random()}"
        wish = {"mode": "replay", "recording": chance.choice(list(self._told.recordings)[-3:])}
        answer = client.post("/api/scans", json=wish, headers={"Idempotency-Key": key})
        if answer.status_code in (404, 409):  # removed for its size; or a live one is under way
            time.sleep(0.01)
            return
        assert answer.status_code == 202, answer.text
        scan = answer.json()
        self._told.scans[scan["id"]] = scan
        self._told.keys[key] = (wish, scan["id"])
        while scan["state"] in ACTIVE_STATES:
            answer = client.get(scan["links"]["self"])
            if answer.status_code == 404:  # ended and removed
                return
            scan = answer.json()
        self._told.scans[scan["id"]] = scan
        assert scan["state"] == "succeeded", scan

    def _mark(self, client: httpx2.Client, chance: random.Random) -> None:
        time.sleep(0.02)
        ended = [name for name, scan in list(self._told.scans.items()) if scan["state"] not in ACTIVE_STATES]
        if ended and len(self._told.kept) < 10:
            name = chance.choice(ended)
            if client.put(f"/api/scans/{name}/keep", json={"kept": True}).status_code == 200:
                self._told.kept.add(name)

    def _list(self, client: httpx2.Client, chance: random.Random) -> None:
        time.sleep(0.02)
        for kind in ("scans", "recordings"):
            listed = [one["id"] for one in client.get(f"/api/{kind}?limit=50").json()[kind]]
            assert listed == sorted(listed, reverse=True)


def assert_there(client: httpx2.Client, told: Acknowledged, retention: bool) -> None:
    """All that was acknowledged; with `retention`, what was not marked may have been removed whole."""

    def get(kind: str, name: str, needed: bool) -> Document | None:
        answer = client.get(f"/api/{kind}/{name}")
        if answer.status_code == 404 and retention and not needed:
            return None
        assert answer.status_code == 200, answer.text
        return answer.json()

    for name, recording in told.recordings.items():
        assert get("recordings", name, needed=False) in (None, recording)
    for name, before in told.scans.items():
        scan = get("scans", name, needed=name in told.kept)
        if scan is None:
            continue
        assert scan["state"] not in ACTIVE_STATES
        assert scan["kept"] or name not in told.kept
        if before["state"] in ACTIVE_STATES:
            assert scan["state"] in ("interrupted", "succeeded")
        else:
            assert scan | {"kept": None} == before | {"kept": None}
        if name in told.kept:
            assert client.get(scan["links"]["recording"]).status_code == 200
    for key, (wish, name) in list(told.keys.items())[-5:]:
        if client.get(f"/api/scans/{name}").status_code == 200:
            again = client.post("/api/scans", json=wish, headers={"Idempotency-Key": key})
            assert (again.status_code, again.json()["id"]) == (202, name)
            assert again.headers["Idempotency-Replayed"] == "true"


@pytest.mark.parametrize(
    ("lives", "live_every"),
    [
        pytest.param(4, 0, id="some"),
        pytest.param(1000, 25, marks=[pytest.mark.soak, pytest.mark.timeout(7200)], id="thousand"),
    ],
)
def test_what_was_acknowledged_outlives_any_kill(
    recording_file: Path, tmp_path: Path, lives: int, live_every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.integrity.repair.describe_untrusted_recording", describe_here)
    chance, content = random.Random(20), recording_file.read_bytes()
    folders = [range(first, min(first + LIVES_OF_A_FOLDER, lives)) for first in range(0, lives, LIVES_OF_A_FOLDER)]
    with quick_services(recording_file, tmp_path / "services.log") as services:
        for folder in folders:
            data, told, retention = tmp_path / f"data-{folder.start}", Acknowledged(), folder.start % 2 == 1
            for number in folder:
                moving = live_every > 0 and number % live_every == live_every - 1
                life = services.start(data, retention=retention, host=free_host() if moving else "-")
                with httpx2.Client(base_url=f"http://127.0.0.1:{life.port}", timeout=60) as client:
                    wait_until(lambda client=client: answers(client))
                    assert_there(client, told, retention)
                    scan = begin_live(client, told) if moving else None
                clients = Clients(life, content, told, chance)
                time.sleep(chance.uniform(1, 6) if scan else chance.uniform(0.2, 2.0))
                os.kill(life.pid, signal.SIGKILL)
                clients.join()
                wait_until(lambda data=data: not is_service_running(data))
                found = {finding.code for finding in check_store(check_target_of(data), running=False).findings}
                assert found <= LEFT, found
            assert told.scans
            assert repair(check_target_of(data), lambda _: None).findings == ()
            life = services.start(data, retention=retention)
            with httpx2.Client(base_url=f"http://127.0.0.1:{life.port}", timeout=60) as client:
                wait_until(lambda client=client: answers(client))
                assert_there(client, told, retention)
            os.kill(life.pid, signal.SIGKILL)


def begin_live(client: httpx2.Client, told: Acknowledged) -> str:
    answer = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042, "views": 4})
    assert answer.status_code == 202, answer.text
    told.scans[answer.json()["id"]] = answer.json()
    return answer.json()["id"]
