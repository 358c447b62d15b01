"""A real service on a real socket, and a small simulated recording."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi import FastAPI
from prometheus_client.parser import text_string_to_metric_families

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.app import create_app
from service.cli.commands.serve import SWITCH_INTERVAL_S, Server
from service.config.loader import ServiceConfig
from service.processing import worker
from service.states import ACTIVE_STATES
from tests.service.described_answers import check_declared, described_operation
from tests.service.faults.figures import Figures
from tests.service.observed_problems import OBSERVED, check_observed, observe_answer

PRELOADED = (
    "recognition.early_end.stepwise",
    "service.processing.worker_main",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
    "cell.simulation.offline_scan",
    "open3d",
    "service.cli.commands.scan",
    "service.cli.commands.viewpoints",
)
"""What recognition processes and forked commands import."""
# This only bounds a hang. A busy machine may take long to start a process.
PATIENCE_S = 120.0
LONGEST_PAUSE_S = 0.1
"""Longest pause between two requests for the state of a job. Each request takes several milliseconds of computing."""


class ServedClient(httpx2.Client):
    """A client with access to the application that it calls."""

    def __init__(self, app: FastAPI, port: int) -> None:
        super().__init__(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S)
        self.app = app
        self.event_hooks["response"] += [observe_answer, check_problem]

    @property
    def recognition_pid(self) -> int:
        """Process id of the recognition of this service. Other services may run in the same test process."""
        process = self.app.state.context.jobs._worker._process
        assert process is not None
        assert process.pid is not None
        return process.pid


def check_problem(answer: httpx2.Response) -> None:
    """Check that a refusal of a described operation has a problem type that the operation declares."""
    if answer.status_code >= 400 and described_operation(answer.request.method, answer.request.url.path):
        answer.read()
        check_declared(answer)


MetricValues = dict[tuple[str, tuple[tuple[str, str], ...]], float]
Serve = Callable[..., AbstractContextManager[ServedClient]]


@pytest.fixture(autouse=True)
def _problems_are_observed(request: pytest.FixtureRequest) -> Iterator[None]:
    """Check after a test with the marker `problem(slug, ...)` that these problems were observed."""
    slugs = {slug for mark in request.node.iter_markers("problem") for slug in mark.args}
    OBSERVED.clear()
    yield
    check_observed(slugs)


@pytest.fixture(scope="session")
def recording_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of four views without noise of one string in an arc."""
    path = tmp_path_factory.mktemp("recording") / "arc.mcap"
    write_simulation(simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, views=4), path)
    return path


@pytest.fixture(scope="session")
def fork_server() -> None:
    """Start the process that those of the context `forkserver` are forked from. It has imported `PRELOADED`."""
    multiprocessing.set_forkserver_preload(list(PRELOADED))
    forkserver.ensure_running()  # now, so that no test counts it among the processes that it has started


@pytest.fixture(scope="session")
def serve(fork_server: None) -> Serve:
    """`serve(data_dir, limits={...})`: start a service in this process on a free port, and yield a client.

    Recognition still runs in its own process. That is forked from one that has imported it already, which saves a
    second of computing at each of many starts. Services in a process of their own start it as users do.
    """

    @contextmanager
    def serving(data_dir: Path, **settings: Any) -> Iterator[ServedClient]:
        app = create_app(ServiceConfig(data_dir=data_dir, **settings))
        # Without log_config, pytest captures the log.
        server = Server(app, port=0, log_level="warning", log_config=None)
        thread = threading.Thread(target=server.run)
        switch_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL_S)  # as `pointchain serve` does
        try:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(worker, "CONTEXT", multiprocessing.get_context("forkserver"))
                thread.start()
                wait_until(lambda: server.started or not thread.is_alive())
            assert server.started, "the service did not start; its log has the reason"
            port = server.servers[0].sockets[0].getsockname()[1]
            with ServedClient(app, port) as client:
                yield client
        finally:
            server.should_exit = True
            thread.join()
            sys.setswitchinterval(switch_s)

    return serving


@pytest.fixture(scope="session")
def client(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """Yield a client of a service that many tests share."""
    limits = {"request_bytes": 4096, "upload_bytes": 2_000_000}
    with serve(tmp_path_factory.mktemp("data"), limits=limits) as shared:
        yield shared


@pytest.fixture
def recording(client: httpx2.Client, recording_file: Path) -> str:
    """Return the id of an uploaded recording."""
    answer = client.post("/api/recordings", content=recording_file.read_bytes())
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


@pytest.fixture(scope="session")
def assert_problem() -> Callable[[httpx2.Response, int, str], str]:
    """`assert_problem(answer, status, slug)`: check that the answer is this problem, and return its detail."""

    def check(answer: httpx2.Response, status: int, slug: str) -> str:
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        problem = answer.json()
        assert problem["type"] == f"urn:pointchain:{slug}"
        assert problem["status"] == status
        assert problem["title"]
        assert problem["instance"] == answer.request.url.path
        return problem["detail"]

    return check


@pytest.fixture(scope="session")
def finished() -> Callable[[httpx2.Client, str], dict[str, Any]]:
    """`finished(client, location)`: wait for a final state, and return the document of the scan."""

    def wait(client: httpx2.Client, location: str) -> dict[str, Any]:
        found: dict[str, Any] = {}

        def ended() -> bool:
            found.update(client.get(location).json())
            return found["state"] not in ACTIVE_STATES

        wait_until(ended, LONGEST_PAUSE_S)
        return found

    return wait


@pytest.fixture(scope="module")
def scan(
    client: ServedClient, recording_file: Path, finished: Callable[[httpx2.Client, str], dict[str, Any]]
) -> dict[str, Any]:
    """Return the document of an ended replay."""
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    return finished(client, answer.headers["Location"])


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Figures:
    """Return the figures of the test. Their times are asserted only in a soak test."""
    return Figures(request.node.name, request.node.get_closest_marker("soak") is not None)


@pytest.fixture
def recognition_process(client: ServedClient) -> int:
    """Return the process id of the recognition of the shared service when it waits for a task."""
    # A scan of an earlier test may still be running, or its preview may still be drawn.
    wait_until(lambda: client.app.state.context.jobs.idle)
    for scan in client.get("/api/scans?limit=1").json()["scans"]:
        if scan["links"]["preview"] is not None:
            client.get(scan["links"]["preview"])
    wait_until(lambda: client.get("/readyz").status_code == 200)
    return client.recognition_pid


@pytest.fixture
def held(recognition_process: int) -> Iterator[int]:
    """Suspend recognition and yield its process id. A scan does not end until the process continues or is killed."""
    os.kill(recognition_process, signal.SIGSTOP)
    yield recognition_process
    if recognition_process in [child.pid for child in multiprocessing.active_children()]:
        os.kill(recognition_process, signal.SIGCONT)


def wait_until(condition: Callable[[], bool], longest_pause_s: float = 0.02) -> None:
    """Wait until `condition` is true, at most `PATIENCE_S`.

    Args:
        condition: Checked again and again.
        longest_pause_s: Longest pause between two checks, for a condition that stays true. The pause is a tenth of the
            time waited so far, and at least 0.02 s.
    """
    begin = time.monotonic()
    while not condition():
        waited_s = time.monotonic() - begin
        assert waited_s < PATIENCE_S, "timeout"
        time.sleep(min(max(0.02, 0.1 * waited_s), longest_pause_s))


def metric_values(client: httpx2.Client) -> MetricValues:
    """Return all samples at `/metrics` by their name and labels."""
    answer = client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }
