"""How the service ends when it is told to: the arm first, whoever is still connected, and in good order."""

import signal
import socket
import sqlite3
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import httpx
import pytest

from cell.simulation.ur_controller.admin_client import AdminClient
from service.api.dependencies import Context
from service.jobs.new_rows import NOBODY, new_scan
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
"""So many read what they are told, and as many do not."""
STOP_S, EXIT_S = 0.05, 5.0
"""So soon behind the signal the controller has been told, and the service has ended."""


@pytest.mark.fault(26)
@pytest.mark.xdist_group("cell")  # one at a time: several busy processes
@rounds(1, 20)
def test_in_the_middle_of_a_move_the_arm_is_stopped_then_all_are_told_and_it_ends_in_order(
    tmp_path: Path, figures: Figures, count: int
) -> None:
    stops_s, exits_s = [], []
    for number in range(count):
        (tmp_path / str(number)).mkdir()
        stop_s, exit_s = ended_in_a_move(tmp_path / str(number))
        stops_s.append(stop_s)
        exits_s.append(exit_s)
    figures.at_most("stop on the wire behind the signal", stops_s, STOP_S)
    figures.at_most("exit", exits_s, EXIT_S)


def ended_in_a_move(tmp_path: Path) -> tuple[float, float]:
    """How long behind the signal the controller was told to stop, and the service had ended."""
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
        # A client that has stopped sending: uvicorn waits for the rest of its request.
        stalled = open_ones.enter_context(socket.create_connection(address))
        stalled.sendall(
            f"POST /api/recordings HTTP/1.1\r\nHost: {address[0]}\r\nContent-Length: 1000\r\n\r\nno more".encode()
        )
        pool = open_ones.enter_context(ThreadPoolExecutor(FOLLOWERS))
        followers: list[Future[list[tuple[float, str]]]] = []
        for number in range(FOLLOWERS):
            begun = threading.Event()
            followers.append(pool.submit(lines, client, streams[number % 2], begun))
            assert begun.wait(PATIENCE_S)
        controller = open_ones.enter_context(closing(AdminClient(host)))
        until(lambda: controller.state().moving, 30.0)
        begin, seen = controller.state().events, []
        told_s = time.monotonic()
        service.send_signal(signal.SIGTERM)
        with suppress(OSError):  # until the service lets the controller go
            while service.poll() is None:
                seen = controller.log(begin)
                service.send_signal(signal.SIGINT)  # impatience changes nothing
                time.sleep(0.01)
        assert service.wait(timeout=60) == 0, (tmp_path / "log").read_text()
        ended_s = time.monotonic() - told_s
        heard = [follower.result(PATIENCE_S) for follower in followers]
    # The controller has seen nothing else, however long it was there for.
    assert stops(seen), f"the arm was not stopped: {seen}"
    assert not motion_commands(seen)
    stopped_s = stops(seen)[0]
    for number, one in enumerate(heard):
        (interrupted,) = [at_s for at_s, line in one if line.startswith("data: ") and '"interrupted"' in line]
        assert interrupted > stopped_s
        assert (one[-1][1] == END) == (number % 2 == 1), "the stream of a scan ends with it, that of everything is told"
    assert "Traceback" not in (tmp_path / "log").read_text()
    with closing(DataFolder(data)) as folder, closing(Store(folder)) as store:
        ended = store.scan(scan["id"])
        assert ended is not None
        assert ended.state == "interrupted"
        assert ended.failure is not None
        assert ended.failure.slug == "interrupted"
        events = store.events.behind(scan["id"], 0)
        assert events is not None
        assert events.events[-1].data["state"] == "interrupted"
    return stopped_s - told_s, ended_s


def lines(client: httpx.Client, path: str, begun: threading.Event) -> list[tuple[float, str]]:
    """All lines of a stream with something on them, and when they came."""
    with client.stream("GET", path) as answer:
        found = []
        for line in answer.iter_lines():
            if line:
                found.append((time.monotonic(), line))
            begun.set()
    return found


def test_ctrl_c_ends_it_in_order_too(tmp_path: Path) -> None:
    with process(tmp_path / "data", tmp_path / "log") as (service, client):
        begun = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            follower = pool.submit(lines, client, "/api/events", begun)
            assert begun.wait(PATIENCE_S)
            service.send_signal(signal.SIGINT)
            assert follower.result(PATIENCE_S)[-1][1] == END
            assert service.wait(timeout=60) == 0, (tmp_path / "log").read_text()


def test_neither_who_takes_nothing_nor_the_database_is_waited_for(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Were a stalled client waited for, it would be for longer than this test is.
    monkeypatch.setattr(uvicorn_server, "ENDING_S", 10 * PATIENCE_S)
    monkeypatch.setattr(uvicorn_server, "CLIENTS_S", 10 * PATIENCE_S)
    with ExitStack() as open_ones:
        client = open_ones.enter_context(serve(tmp_path))
        context: Context = client.app.state.context
        scan = new_scan("live", "graph", None, NOBODY)
        context.store.add_scan(scan)
        host, port = client.base_url.host, client.base_url.port or 80
        silent = socket.create_connection((host, port))
        silent.sendall(f"GET /api/scans/{scan.id}/events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        wait_until(lambda: context.streams.open == 1)
        # More than the system keeps for a connection, some MB on each side.
        for number in range(100):
            context.store.update_scan(scan.id, stage="x" * 250_000, fraction=number / 100)

        stopped = threading.Event()
        monkeypatch.setattr(context.cell, "stop", stopped.set)
        context.cell._status.change(state="busy")
        # Whoever writes a final row has the place while he waits for the database.
        with closing(sqlite3.connect(context.store.folder.database)) as other, context.jobs._place._turn:
            other.execute("BEGIN EXCLUSIVE")
            winding_up = threading.Thread(target=context.jobs.wind_up)
            winding_up.start()
            assert stopped.wait(PATIENCE_S)
            assert winding_up.is_alive()  # and only now waits for the place
        winding_up.join()
        context.cell._status.change(state="not_ready")
        left = time.monotonic()
        open_ones.close()
        silent.close()
    assert time.monotonic() - left < PATIENCE_S
