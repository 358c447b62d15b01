"""Fault 22: another program locks the database for a long time."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.integrity.check import check_store
from tests.service.conftest import Serve, wait_until
from tests.service.faults.locked_database import OtherProcess
from tests.service.faults.recognition_stub import RecognitionStub, stub_factory
from tests.service.live_cell import live_cell
from tests.service.stored_data import check_target_of

pytestmark = [pytest.mark.fault(22), pytest.mark.xdist_group("service")]

Problem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Make = Callable[[], RecognitionStub]

ANSWER_S = 5.5
"""Time limit of a refusal, in seconds. It is asserted only with the real waiting time."""
REAL = pytest.param(None, marks=[pytest.mark.soak, pytest.mark.timeout(600)], id="as-it-is")
SHORT = pytest.param(0.5, id="short")
"""How long the service waits for the database, in seconds; None for the real time."""


@pytest.fixture(scope="module")
def recognition(recording_file: Path) -> Make:
    """A factory of stubs of recognition."""
    return stub_factory(recording_file)


@pytest.fixture
def busy_s(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, recognition: Make) -> float | None:
    """How long the service waits for the database, in seconds; None for the real time."""
    monkeypatch.setattr("service.jobs.manager.RecognitionWorker", recognition)
    if request.param is not None:
        monkeypatch.setattr("service.storage.database.BUSY_S", request.param)
        monkeypatch.setattr("service.jobs.runner.RETRY_S", 0.1)
    return request.param


@pytest.mark.parametrize("busy_s", [SHORT, REAL], indirect=True)
def test_changes_are_refused_in_time_and_reads_continue(
    serve: Serve,
    tmp_path: Path,
    recording_file: Path,
    busy_s: float | None,
    assert_problem: Problem,
    finished: Finished,
) -> None:
    content, times = recording_file.read_bytes(), list[float]()
    with serve(tmp_path / "data") as client, ThreadPoolExecutor(10) as pool:
        recording = client.post("/api/recordings", content=content).json()["id"]
        scan_body = {"mode": "replay", "recording": recording}
        done = client.post("/api/scans", json=scan_body).headers["Location"]
        assert finished(client, done)["state"] == "succeeded"

        def refused(method: str, path: str, **body: Any) -> None:
            started_s = time.monotonic()
            answer = client.request(method, path, **body)
            times.append(time.monotonic() - started_s)
            if answer.status_code == 409:  # while another request waits for the database
                assert_problem(answer, 409, "cell-busy")
            else:
                assert_problem(answer, 503, "busy")
            assert int(answer.headers["Retry-After"]) > 0

        with closing(OtherProcess(tmp_path / "data")) as other, other.locking():
            until = time.monotonic() + (10.0 if busy_s is None else 0.0)
            while True:
                waiting = [pool.submit(refused, "POST", "/api/scans", json=scan_body) for _ in range(6)]
                waiting += [pool.submit(refused, "PUT", f"{done}/keep", json={"kept": True})]
                waiting += [pool.submit(refused, "POST", "/api/recordings", content=content)]
                while not all(one.done() for one in waiting):
                    for path in (done, "/api/scans", f"/api/recordings/{recording}", f"{done}/model", "/api/cell"):
                        assert client.get(path).status_code == 200
                    time.sleep(0.05)
                for one in waiting:
                    one.result()
                assert client.post("/api/cell/stop").status_code == 200
                if time.monotonic() > until:
                    break
        if busy_s is None:
            assert max(times) <= ANSWER_S
        kept = client.put(f"{done}/keep", json={"kept": True})
        assert kept.json()["kept"]
        assert finished(client, client.post("/api/scans", json=scan_body).headers["Location"])["state"] == "succeeded"


@pytest.mark.parametrize("busy_s", [SHORT, REAL], indirect=True)
@pytest.mark.parametrize("stop", [True, pytest.param(False, marks=pytest.mark.soak)])
def test_a_live_scan_makes_no_further_move(
    serve: Serve, tmp_path: Path, busy_s: float | None, stop: bool, finished: Finished
) -> None:
    data = tmp_path / "data"
    with live_cell(serve, data, time_factor=5.0) as cell, closing(OtherProcess(data)) as other:
        location = cell.start(views=3)
        cell.wait_for_motion(location)
        views = cell.views(location)
        with other.locking():
            if stop:
                assert cell.client.post("/api/cell/stop").status_code == 200
            still_s = time.monotonic()
            while time.monotonic() < still_s + 0.5:
                if cell.moving():  # to the viewpoint of the last move before the lock
                    still_s = time.monotonic()
            assert cell.client.get(location).status_code == 200
            wait_until(lambda: time.monotonic() > still_s + (10.0 if busy_s is None else 2.0))
            assert cell.events("motion_start", after_s=still_s) == []
            assert cell.views(location) == views  # no progress could be stored
        scan = finished(cell.client, location)
        state, slug = ("aborted", "aborted") if stop else ("failed", "busy")
        assert (scan["state"], scan["problem"]["type"]) == (state, f"urn:pointchain:{slug}")
        recorded = [view["index"] for view in scan["progress"]["views"] if view["state"] == "recorded"]
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] >= len(recorded) >= 1
        assert cell.events("motion_start", after_s=still_s) == []
        cell.is_well()
        assert finished(cell.client, cell.start(views=2))["state"] == "succeeded"
    assert check_store(check_target_of(data), running=False).findings == ()
