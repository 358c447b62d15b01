"""The shutdown of the service: the arm stops first, then clients are informed, and the service shuts down cleanly."""

import signal
import socket
import sqlite3
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import httpx2
import pytest

from cell.simulation.ur_controller.admin_client import AdminClient
from recognition.request import RecognitionRequest
from service.api.dependencies import Context
from service.jobs.submission import NOBODY, new_scan
from service.server import uvicorn_server
from service.storage.data_folder import DataFolder
from service.storage.store import Store
from tests.cell.arm.virtual_arm import motion_commands, stops, until
from tests.cell.loopback import free_host
from tests.service.conftest import PATIENCE_S, Serve, wait_until
from tests.service.faults.figures import Figures, rounds
from tests.service.service_process import process

END = ": the service is stopping"
FOLLOWERS = 5
"""Number of clients that read their event stream, and of those that do not."""
STOP_S, EXIT_S = 0.05, 5.0
"""Maximum time from the signal to the stop command at the controller, and to the end of the service."""


@pytest.mark.fault(26)
@pytest.mark.xdist_group("service")  # one at a time, because the test runs several busy processes
@rounds(1, 20)
def test_a_shutdown_during_a_move_stops_the_arm_and_then_informs_all_clients(
    tmp_path: Path, figures: Figures, count: int
) -> None:
    stops_s, exits_s = [], []
    for number in range(count):
        (tmp_path / str(number)).mkdir()
        stop_s, exit_s = shut_down_during_a_move(tmp_path / str(number))
        stops_s.append(stop_s)
        exits_s.append(exit_s)
    figures.at_most("stop on the wire after the signal", stops_s, STOP_S)
    figures.at_most("exit", exits_s, EXIT_S)


def shut_down_during_a_move(tmp_path: Path) -> tuple[float, float]:
    """Return the time from the signal to the stop command at the controller, and to the end of the service."""
    data, host = tmp_path / "data", free_host()
    variables = {"POINTCHAIN_ARM__HOST": host, "POINTCHAIN_ARM__TIME_FACTOR": "4", "POINTCHAIN_ARM__WATCHDOG_HZ": "1"}
    with process(data, tmp_path / "log", **variables) as (service, client), ExitStack() as open_ones:
        scan = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042}).json()
        while not client.get(scan["links"]["self"]).json()["progress"]["views"]:
            time.sleep(0.02)
        address = (client.base_url.host, client.base_url.port or 80)
        streams = [scan["links"]["events"], "/api/events"]
        for number in range(FOLLOWERS):
            silent = open_ones.enter_context(socket.create_connection(address))
            silent.sendall(f"GET {streams[number % 2]} HTTP/1.1\r\nHost: {address[0]}\r\n\r\n".encode())
        # A client that stops sending: uvicorn waits for the rest of its request.
        stalled = open_ones.enter_context(socket.create_connection(address))
        stalled.sendall(
            f"POST /api/recordings HTTP/1.1\r\nHost: {address[0]}\r\nContent-Length: 1000\r\n\r\nno more".encode()
        )
        pool = open_ones.enter_context(ThreadPoolExecutor(FOLLOWERS))
        followers: list[Future[list[tuple[float, str]]]] = []
        for number in range(FOLLOWERS):
            started = threading.Event()
            followers.append(pool.submit(lines, client, streams[number % 2], started))
            assert started.wait(PATIENCE_S)
        controller = open_ones.enter_context(closing(AdminClient(host)))
        until(lambda: controller.state().moving, 30.0)
        begin, seen = controller.state().events, []
        signal_s = time.monotonic()
        service.send_signal(signal.SIGTERM)
        with suppress(OSError):  # until the service disconnects from the controller
            while service.poll() is None:
                seen = controller.log(begin)
                service.send_signal(signal.SIGINT)  # further signals change nothing
                time.sleep(0.01)
        assert service.wait(timeout=60) == 0, (tmp_path / "log").read_text()
        ended_s = time.monotonic() - signal_s
        received = [follower.result(PATIENCE_S) for follower in followers]
    # The controller has received no further motion command.
    assert stops(seen), f"the arm was not stopped: {seen}"
    assert not motion_commands(seen)
    stopped_s = stops(seen)[0]
    for number, one in enumerate(received):
        (interrupted,) = [at_s for at_s, line in one if line.startswith("data: ") and '"interrupted"' in line]
        assert interrupted > stopped_s
        assert (one[-1][1] == END) == (number % 2 == 1), (
            "the stream of a scan ends with the scan, the other stream ends with a comment"
        )
    assert "Traceback" not in (tmp_path / "log").read_text()
    with closing(DataFolder(data)) as folder, closing(Store(folder)) as store:
        ended = store.scans.get(scan["id"])
        assert ended is not None
        assert ended.state == "interrupted"
        assert ended.failure is not None
        assert ended.failure.slug == "interrupted"
        events = store.events.since(scan["id"], 0)
        assert events is not None
        assert events.events[-1].data["state"] == "interrupted"
    return stopped_s - signal_s, ended_s


def lines(client: httpx2.Client, path: str, started: threading.Event) -> list[tuple[float, str]]:
    """Return all non-empty lines of a stream, and when each one arrived."""
    with client.stream("GET", path) as answer:
        found = []
        for line in answer.iter_lines():
            if line:
                found.append((time.monotonic(), line))
            started.set()
    return found


def test_ctrl_c_ends_the_service_in_order(tmp_path: Path) -> None:
    with process(tmp_path / "data", tmp_path / "log") as (service, client):
        started = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            follower = pool.submit(lines, client, "/api/events", started)
            assert started.wait(PATIENCE_S)
            service.send_signal(signal.SIGINT)
            assert follower.result(PATIENCE_S)[-1][1] == END
            assert service.wait(timeout=60) == 0, (tmp_path / "log").read_text()


def test_a_shutdown_waits_neither_for_a_stalled_client_nor_for_the_database(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # If the shutdown waited for a stalled client, it would take longer than the limit of this test.
    monkeypatch.setattr(uvicorn_server, "GRACEFUL_SHUTDOWN_S", 10 * PATIENCE_S)
    monkeypatch.setattr(uvicorn_server, "CLIENT_SHUTDOWN_S", 10 * PATIENCE_S)
    with ExitStack() as open_ones:
        client = open_ones.enter_context(serve(tmp_path))
        context: Context = client.app.state.context
        scan = new_scan("live", RecognitionRequest(), NOBODY)
        context.store.scans.add(scan)
        host, port = client.base_url.host, client.base_url.port or 80
        silent = socket.create_connection((host, port))
        silent.sendall(f"GET /api/scans/{scan.id}/events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        wait_until(lambda: context.streams.open == 1)
        # More than the buffers of a connection hold, a few MB on each side.
        for number in range(100):
            context.store.scans.update(scan.id, stage="x" * 250_000, fraction=number / 100)

        stopped = threading.Event()
        monkeypatch.setattr(context.cell, "stop", stopped.set)
        context.cell._status.change(state="busy")
        # A job that writes its final row holds the lock while it waits for the database.
        with closing(sqlite3.connect(context.store.folder.database)) as other, context.jobs._lock._lock:
            other.execute("BEGIN EXCLUSIVE")
            draining = threading.Thread(target=context.jobs.drain)
            draining.start()
            assert stopped.wait(PATIENCE_S)
            assert draining.is_alive()  # it waits for the lock only after the stop
        draining.join()
        context.cell._status.change(state="not_ready")
        begin_s = time.monotonic()
        open_ones.close()
        silent.close()
    assert time.monotonic() - begin_s < PATIENCE_S
