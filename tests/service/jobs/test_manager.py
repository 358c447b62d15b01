"""Jobs when all threads are busy, the database is damaged, or the preview of an earlier scan is still drawn."""

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
from recognition.request import RecognitionRequest
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
from tests.service.security.conftest import without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]

ANSWER_S = 15.0
"""Time limit of an answer, seconds. It only bounds a hang."""


@contextmanager
def all_threads_busy(client: ServedClient) -> Iterator[None]:
    """Occupy every thread of the service with a request that ends with the context."""
    begun, all_released = threading.Semaphore(0), threading.Event()

    def wait() -> None:
        begun.release()
        all_released.wait()

    async def thread_count() -> float:
        return to_thread.current_default_thread_limiter().total_tokens

    client.app.add_api_route("/most", thread_count)
    client.app.add_api_route("/wait", wait)
    # The service refuses a route that is not in its table of roles.
    allow_routes = patch.dict(
        roles._FIXED, {("GET", path): roles.Call(f"GET {path}", None) for path in ("/most", "/wait")}
    )
    with allow_routes:
        count = int(client.get("/most").json())
    with allow_routes, ThreadPoolExecutor(count) as pool:
        try:
            for _ in range(count):
                pool.submit(client.get, "/wait")
            for _ in range(count):
                assert begun.acquire(timeout=ANSWER_S)
            yield
        finally:
            all_released.set()


def start(client: httpx2.Client, recording_file: Path) -> str:
    """Upload the recording, start a replay of it, and return the address of the scan."""
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert answer.status_code == 202, answer.text
    return answer.headers["location"]


def idle_recognition_pid(client: ServedClient) -> int:
    """Return the process id of this service's recognition when it waits for a task."""
    wait_until(lambda: client.get("/readyz").status_code == 200)
    return client.recognition_pid


def test_stop_and_cancel_do_not_wait_for_other_requests(
    serve: Serve, recording_file: Path, tmp_path: Path, assert_problem: AssertProblem
) -> None:
    with serve(tmp_path) as client:
        os.kill(idle_recognition_pid(client), signal.SIGSTOP)  # the scan does not end
        location = start(client, recording_file)
        with all_threads_busy(client):
            assert client.post("/api/cell/stop", timeout=ANSWER_S).status_code == 200
            cancelled = client.post(f"{location}/cancel", timeout=ANSWER_S)
            assert cancelled.json()["state"] == "aborted"
            assert_problem(client.post("/api/scans/none/cancel", timeout=ANSWER_S), 404, "scan-not-found")


def test_the_service_closes_while_requests_hold_all_threads(tmp_path: Path) -> None:
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
            app.state.context.jobs.close()  # so that a failure leaves no recognition process

    anyio.run(open_and_close)
    DataFolder(tmp_path).close()  # the lock of the folder was released


def test_a_failure_while_closing_does_not_keep_the_rest_open(
    serve: Serve, recording_file: Path, tmp_path: Path
) -> None:
    with serve(tmp_path) as client:
        os.kill(idle_recognition_pid(client), signal.SIGSTOP)
        location = start(client, recording_file)
        wait_until(lambda: client.get(location).json()["state"] == "processing")
        store: Store = client.app.state.context.store
        store.close()  # closes its connections; the next one finds a file that is not a database
        for path in tmp_path.glob("pointchain.sqlite3*"):
            path.write_bytes(b"x" * 4096)
        cell = client.app.state.context.cell
    assert cell.status.reason == "the service is ending"
    DataFolder(tmp_path).close()


def add_live_scan(store: Store, state: ScanState) -> str:
    """Add a live scan whose recording file exists without a row in the store, and return its id."""
    scan_id = new_id()
    store.scans.add(
        ScanRow(scan_id, "live", None, RecognitionRequest(), state, None, 0.1, now(), now(), None, None, None)
    )
    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=0.004, T_flange_camera=np.eye(4))
    K = np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]])
    with RecordingWriter(store.folder.recording(scan_id), header) as writer:
        writer.write_view(View(0, np.full((40, 64), 5000, np.uint16), 1e-4, K, np.eye(4), np.eye(4)))
    return scan_id


def test_a_recording_without_a_row_is_adopted_at_the_next_start(serve: Serve, tmp_path: Path) -> None:
    folder = DataFolder(tmp_path)
    store = Store(folder)
    # Killed during the scan; killed again after the scan was marked; failed because the database was locked.
    scans = [add_live_scan(store, state) for state in ("scanning", "interrupted", "failed")]
    unreadable = add_live_scan(store, "failed")
    folder.recording(unreadable).unlink()
    folder.recording(unreadable).mkdir()
    store.close()
    folder.close()
    with without_recognition(serve, tmp_path) as client:
        for scan_id in scans:
            scan = client.get(f"/api/scans/{scan_id}").json()
            assert scan["recording"] == scan_id
            assert client.get(f"/api/recordings/{scan_id}").json()["views"] == 1
            assert client.get(scan["links"]["recording"]).status_code == 200


def suspend_before_preview(client: ServedClient, recording_file: Path) -> tuple[str, int, Jobs]:
    """Return the address of a succeeded scan, the process id of recognition, and the jobs.

    The process is suspended before it has drawn the preview of the scan, unless drawing was faster.
    """
    process, jobs = idle_recognition_pid(client), client.app.state.context.jobs
    location = start(client, recording_file)
    wait_until(lambda: jobs.is_drawing(Path(location).name) and client.get(location).json()["state"] == "succeeded")
    os.kill(process, signal.SIGSTOP)
    return location, process, jobs


def test_removing_a_scan_while_its_preview_is_drawn_causes_no_error(
    serve: Serve, recording_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with serve(tmp_path) as client:
        location, process, jobs = suspend_before_preview(client, recording_file)
        later = datetime.now(UTC) + timedelta(days=2)
        assert sweep(client.app.state.context.store, RetentionConfig(max_age_days=1), later, lambda: True)
        os.kill(process, signal.SIGCONT)
        wait_until(lambda: not jobs.is_drawing(Path(location).name))
        assert client.get(location).status_code == 404
        metrics = client.get("/metrics").text
        assert 'pointchain_scans_total{mode="replay",outcome="succeeded"} 1.0' in metrics
        assert 'pointchain_scans_total{mode="replay",outcome="failed"} 0.0' in metrics
        assert list((tmp_path / "incoming").iterdir()) == []
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def test_a_cancel_of_the_next_scan_does_not_interrupt_the_preview(
    serve: Serve, recording_file: Path, tmp_path: Path, finished: Finished
) -> None:
    with serve(tmp_path) as client:
        first, process, _ = suspend_before_preview(client, recording_file)
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


def test_a_hanging_preview_does_not_block_a_cancel(
    serve: Serve, recording_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.manager.PREVIEW_TIMEOUT_S", 0.1)
    with serve(tmp_path) as client:
        first, _, jobs = suspend_before_preview(client, recording_file)
        body = {"mode": "replay", "recording": client.get(first).json()["recording"]}
        second = client.post("/api/scans", json=body).headers["Location"]
        assert client.post(f"{second}/cancel", timeout=ANSWER_S).json()["state"] == "aborted"
        wait_until(lambda: jobs.idle)


@pytest.mark.parametrize("killed", [False, True])
def test_an_incomplete_preview_is_never_sent(
    *,
    serve: Serve,
    recording_file: Path,
    tmp_path: Path,
    finished: Finished,
    assert_problem: AssertProblem,
    killed: bool,
) -> None:
    with serve(tmp_path) as client:
        process = idle_recognition_pid(client)
        os.kill(process, signal.SIGSTOP)
        location = start(client, recording_file)
        # The preview is first written to this path, which exists, so that drawing it fails.
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
