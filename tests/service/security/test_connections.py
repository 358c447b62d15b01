"""However many connections somebody without a token holds, a stop comes in."""

import logging
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from service.security.auth.tokens import add_token
from service.server import connections as connection
from service.server.connections import GuardedConnection, backlog, most_connections
from service.server.file_limit import open_files, raise_open_files
from tests.service import service_process
from tests.service.conftest import PATIENCE_S, Serve, ServedClient, wait_until
from tests.service.security.conftest import bearer, connect, port_of, read_all, without_recognition
from tests.service.service_process import answers, process

MOST = 8
HEALTH = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
LARGE = b"GET /static-offline-docs/swagger-ui-bundle.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 10
"""More than the system keeps for a connection, some MB on each side."""


@dataclass(frozen=True)
class Crowded:
    """A service that keeps few connections."""

    client: ServedClient
    token: dict[str, str]

    def stop(self) -> httpx.Response:
        """By a connection of its own."""
        return httpx.post(f"{self.client.base_url}/api/cell/stop", headers=self.token, timeout=PATIENCE_S)

    def follow(self) -> socket.socket:
        """An event stream that has begun."""
        head = f"GET /api/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: {self.token['Authorization']}\r\n\r\n"
        return held(port_of(self.client), head.encode())


@pytest.fixture(scope="module")
def service(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Crowded]:
    data = tmp_path_factory.mktemp("crowded")
    token = bearer(add_token(data, "ann", "viewer"))
    with without_recognition(serve, data, limits={"event_streams_each": MOST}) as client:
        yield Crowded(client, token)


@pytest.fixture
def crowded(service: Crowded, monkeypatch: pytest.MonkeyPatch) -> Crowded:
    """Few from now on, of which nothing is told yet."""
    monkeypatch.setattr(connection, "MOST", MOST)
    monkeypatch.setattr(GuardedConnection, "_told_s", float("-inf"))
    return service


def held(port: int, sent: bytes) -> socket.socket:
    """A connection on which this was sent; if it is a request, its answer has begun."""
    one = connect(port)
    one.sendall(sent)
    if sent.endswith(b"\r\n\r\n"):
        assert one.recv(64).startswith(b"HTTP/1.1 200 ")
    return one


def is_open(one: socket.socket) -> bool:
    """Whether the service still has it."""
    one.settimeout(0.0)
    try:
        while one.recv(65536):
            pass
    except BlockingIOError:
        return True
    except ConnectionResetError:
        pass
    return False


def told(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name == connection.__name__]


@pytest.mark.parametrize("sent", [b"", b"GET /heal", HEALTH], ids=["nothing", "half-a-head", "keep-alive"])
def test_who_asks_for_nothing_makes_room_and_who_has_for_longest_first(
    crowded: Crowded, sent: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with ExitStack() as open_ones, caplog.at_level(logging.WARNING):
        streams = [open_ones.enter_context(crowded.follow()) for _ in range(2)]
        silent = [open_ones.enter_context(held(port_of(crowded.client), sent)) for _ in range(3 * MOST)]
        assert crowded.stop().status_code == 200
        # As many are left as there is room for beside the two streams and the stop.
        left = MOST - 3
        wait_until(lambda: not any(is_open(one) for one in silent[:-left]))
        assert all(is_open(one) for one in silent[-left:])
        assert all(is_open(one) for one in streams), "who is at work stays"
    (one,) = told(caplog)
    assert "idle ones are closed" in one


def test_who_takes_what_is_open_to_everybody_does_not_keep_a_stop_out(crowded: Crowded) -> None:
    with ExitStack() as open_ones:
        for _ in range(MOST):
            open_ones.enter_context(held(port_of(crowded.client), LARGE))
        assert crowded.stop().status_code == 200


def test_no_work_is_given_up_for_somebody_new(crowded: Crowded, caplog: pytest.LogCaptureFixture) -> None:
    with ExitStack() as open_ones:
        streams = [open_ones.enter_context(crowded.follow()) for _ in range(MOST)]
        with connect(port_of(crowded.client)) as one_more:
            assert read_all(one_more) == b""
        assert all(is_open(one) for one in streams)
        (one,) = told(caplog)
        assert "new ones are closed" in one
        streams[0].close()
        slots = crowded.client.app.state.context.streams
        wait_until(lambda: slots.open < MOST)
        assert crowded.stop().status_code == 200


def test_never_more_than_take_half_of_the_files(monkeypatch: pytest.MonkeyPatch) -> None:
    for files, most, at_once in ((256, 128, 32), (1024, 512, 128), (1 << 20, 512, 2048)):
        monkeypatch.setattr(connection, "open_files", lambda files=files: files)
        assert (most_connections(), backlog()) == (most, at_once)


def test_all_files_that_the_system_grants_are_taken() -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft - 1, hard))
        assert open_files() == soft - 1
        raise_open_files()
        assert open_files() == hard
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_with_few_files_many_do_not_keep_a_stop_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("resource")
    limits = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (128, 256)); "
    monkeypatch.setattr(service_process, "SERVE", limits + service_process.SERVE)
    data, log = tmp_path / "data", tmp_path / "log"
    token = bearer(add_token(data, "ann", "viewer"))
    with process(data, log) as (running, client), ExitStack() as open_ones:
        client.headers.update(token)
        wait_until(lambda: answers(client))
        assert f"{'Max open files':<26}256 " in Path(f"/proc/{running.pid}/limits").read_text()
        for _ in range(300):
            open_ones.enter_context(held(client.base_url.port or 80, HEALTH))
        stop = httpx.post(f"{client.base_url}/api/cell/stop", headers=token, timeout=PATIENCE_S)
        assert stop.status_code == 200
        told = log.read_text()
        assert told.count("connections are open, and more come: idle ones are closed for them") == 1
        assert "out of system resource" not in told
        assert "Traceback" not in told
