"""What the service keeps to when its threads, its disk or its database fail it."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import patch

import anyio
import httpx2
import numpy as np
import pytest
from anyio import to_thread

from cell.devices import View
from cell.recording import RecordingWriter
from cell.recording.header import RecordingHeader
from service.app import create_app
from service.config.loader import ServiceConfig
from service.config.sections import RetentionConfig
from service.jobs.manager import Jobs
from service.security.auth import roles
from service.states import ScanState
from service.storage.data_folder import DataFolder
from service.storage.database import new_id, now
from service.storage.retention import sweep
from service.storage.rows import ScanRow
from service.storage.store import Store
from tests.service.conftest import Serve, ServedClient, wait_until

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]

ANSWER_S = 15.0
"""Only bounds a hang: a service that waits for what never comes does not answer at all."""


@contextmanager
def all_threads_taken(client: ServedClient) -> Iterator[None]:
    """As many requests as the service works on at once, none of which ends before this does."""
    begun, let_go = threading.Semaphore(0), threading.Event()

    def wait() -> None:
        begun.release()
        let_go.wait()

    async def most() -> float:
        return to_thread.current_default_thread_limiter().total_tokens

    client.app.add_api_route("/most", most)
    client.app.add_api_route("/wait", wait)
    # The service lets nobody through to a route that its table of roles does not have.
    let_in = patch.dict(roles._FIXED, {("GET", path): roles.Call(f"GET {path}", None) for path in ("/most", "/wait")})
    with let_in:
        count = int(client.get("/most").json())
    with let_in, ThreadPoolExecutor(count) as pool:
        try:
            for _ in range(count):
                pool.submit(client.get, "/wait")
            for _ in range(count):
                assert begun.acquire(timeout=ANSWER_S)
            yield
        finally:
            let_go.set()


def start(client: httpx2.Client, recording_file: Path) -> str:
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert answer.status_code == 202, answer.text
    return answer.headers["location"]


def recognition(client: ServedClient) -> int:
    """The process of this very service, once it waits for a task."""
    wait_until(lambda: client.get("/readyz").status_code == 200)
    return client.recognition_pid


def test_stop_and_cancel_wait_for_no_other_request(
    serve: Serve, recording_file: Path, tmp_path: Path, assert_problem: AssertProblem
) -> None:
    with serve(tmp_path) as client:
        os.kill(recognition(client), signal.SIGSTOP)  # the scan stays under way
        location = start(client, recording_file)
        with all_threads_taken(client):
            assert client.post("/api/cell/stop", timeout=ANSWER_S).status_code == 200
            cancelled = client.post(f"{location}/cancel", timeout=ANSWER_S)
            assert cancelled.json()["state"] == "aborted"
            assert_problem(client.post("/api/scans/none/cancel", timeout=ANSWER_S), 404, "scan-not-found")


def test_the_service_closes_though_requests_hold_all_threads(tmp_path: Path) -> None:
    async def open_and_close() -> None:
        app = create_app(ServiceConfig(data_dir=tmp_path))
        lifespan = app.router.lifespan_context(app)
        await lifespan.__aenter__()
        shared = to_thread.current_default_thread_limiter()
        for _ in range(int(shared.total_tokens)):
            shared.acquire_on_behalf_of_nowait(object())
        try:
            with anyio.fail_after(ANSWER_S):
                await lifespan.__aexit__(None, None, None)
        finally:
            app.state.context.jobs.close()  # else a failure would leave recognition behind

    anyio.run(open_and_close)
    DataFolder(tmp_path).close()  # let go


def test_what_cannot_be_closed_keeps_nothing_else_open(serve: Serve, recording_file: Path, tmp_path: Path) -> None:
    with serve(tmp_path) as client:
        os.kill(recognition(client), signal.SIGSTOP)
        location = start(client, recording_file)
        wait_until(lambda: client.get(location).json()["state"] == "processing")
        store: Store = client.app.state.context.store
        store.close()  # the connections that it has; the next one meets a database that is none
        for path in tmp_path.glob("pointchain.sqlite3*"):
            path.write_bytes(b"x" * 4096)
        cell = client.app.state.context.cell
    assert cell.status.reason == "the service is ending"
    DataFolder(tmp_path).close()


def live_scan(store: Store, state: ScanState) -> str:
    """A live scan whose recording lies in its place, but was not taken into the store."""
    scan_id = new_id()
    store.scans.add(ScanRow(scan_id, "live", None, "graph", None, state, None, 0.1, now(), now(), None, None, None))
    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=0.004, T_flange_camera=np.eye(4))
    K = np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]])
    with RecordingWriter(store.folder.recording(scan_id), header) as writer:
        writer.write_view(View(0, np.full((40, 64), 5000, np.uint16), 1e-4, K, np.eye(4), np.eye(4)))
    return scan_id


def test_a_recording_is_found_again_by_any_later_start(serve: Serve, tmp_path: Path) -> None:
    folder = DataFolder(tmp_path)
    store = Store(folder)
    # Under way when the service was killed; marked by a start that was killed then; failed on a locked database.
    scans = [live_scan(store, state) for state in ("scanning", "interrupted", "failed")]
    unreadable = live_scan(store, "failed")
    folder.recording(unreadable).unlink()
    folder.recording(unreadable).mkdir()
    store.close()
    folder.close()
    with serve(tmp_path) as client:
        for scan_id in scans:
            scan = client.get(f"/api/scans/{scan_id}").json()
            assert scan["recording"] == scan_id
            assert client.get(f"/api/recordings/{scan_id}").json()["views"] == 1
            assert client.get(scan["links"]["recording"]).status_code == 200


def frozen_while_it_draws(client: ServedClient, recording_file: Path) -> tuple[str, int, Jobs]:
    """Return a scan that has succeeded, and its recognition process.

    The process is suspended before the preview of the scan is drawn, unless that was quicker.
    """
    process, jobs = recognition(client), client.app.state.context.jobs
    location = start(client, recording_file)
    wait_until(lambda: jobs.is_drawing(Path(location).name) and client.get(location).json()["state"] == "succeeded")
    os.kill(process, signal.SIGSTOP)
    return location, process, jobs


def test_a_scan_whose_results_are_removed_while_its_picture_is_drawn_has_succeeded(
    serve: Serve, recording_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with serve(tmp_path) as client:
        location, process, jobs = frozen_while_it_draws(client, recording_file)
        later = datetime.now(UTC) + timedelta(days=2)
        assert sweep(client.app.state.context.store, RetentionConfig(max_age_days=1), later, lambda: True)
        os.kill(process, signal.SIGCONT)
        wait_until(lambda: not jobs.is_drawing(Path(location).name))
        assert client.get(location).status_code == 404
        told = client.get("/metrics").text
        assert 'pointchain_scans_total{mode="replay",outcome="succeeded"} 1.0' in told
        assert 'pointchain_scans_total{mode="replay",outcome="failed"} 0.0' in told
        assert list((tmp_path / "incoming").iterdir()) == []
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def test_who_cancels_the_next_scan_does_not_end_the_picture_of_the_last(
    serve: Serve, recording_file: Path, tmp_path: Path, finished: Finished
) -> None:
    with serve(tmp_path) as client:
        first, process, _ = frozen_while_it_draws(client, recording_file)
        with ThreadPoolExecutor(1) as pool:
            body = {"mode": "replay", "recording": client.get(first).json()["recording"]}
            second = client.post("/api/scans", json=body).headers["Location"]
            cancelling = pool.submit(client.post, f"{second}/cancel", timeout=ANSWER_S)
            wait_until(lambda: client.get(second).json()["state"] in ("stopping", "aborted"))
            os.kill(process, signal.SIGCONT)
            assert cancelling.result().json()["state"] == "aborted"
        assert finished(client, first)["state"] == "succeeded"
        assert client.get(client.get(first).json()["links"]["preview"]).status_code == 200
        assert client.recognition_pid == process


def test_a_picture_that_does_not_end_keeps_no_cancelled_scan(
    serve: Serve, recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.manager.PREVIEW_TIMEOUT_S", 0.1)
    with serve(tmp_path) as client:
        first, _, jobs = frozen_while_it_draws(client, recording_file)
        body = {"mode": "replay", "recording": client.get(first).json()["recording"]}
        second = client.post("/api/scans", json=body).headers["Location"]
        assert client.post(f"{second}/cancel", timeout=ANSWER_S).json()["state"] == "aborted"
        wait_until(lambda: jobs.idle)


@pytest.mark.parametrize("killed", [False, True])
def test_a_picture_that_is_not_whole_is_never_shown(
    *,
    serve: Serve,
    recording_file: Path,
    tmp_path: Path,
    finished: Finished,
    assert_problem: AssertProblem,
    killed: bool,
) -> None:
    with serve(tmp_path) as client:
        process = recognition(client)
        os.kill(process, signal.SIGSTOP)
        location = start(client, recording_file)
        # Where the picture is to be written first, so that it can't be.
        part = tmp_path / "incoming" / f"{Path(location).name}.png"
        part.write_bytes(b"\x89PNG")
        os.kill(process, signal.SIGCONT)
        scan = finished(client, location)
        assert scan["state"] == "succeeded"
        if killed:
            os.kill(process, signal.SIGKILL)
        assert_problem(client.get(scan["links"]["preview"]), 404, "no-result")
        assert not part.exists()
        assert client.get(scan["links"]["model"]).status_code == 200
