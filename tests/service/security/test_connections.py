"""A stop gets through, however many connections a client without a token holds."""

import logging
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from service.security.auth.tokens import add_token
from service.server import connections as connection
from service.server.connections import GuardedConnection, backlog, connection_limit
from service.server.file_limit import open_file_limit, raise_file_limit
from tests.service import service_process
from tests.service.conftest import PATIENCE_S, Serve, ServedClient, wait_until
from tests.service.security.conftest import bearer, connect, port_of, read_all, without_recognition
from tests.service.service_process import answers, process

LIMIT = 8
HEALTH = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
LARGE = b"GET /static-offline-docs/swagger-ui-bundle.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 10
"""More than the buffers of a connection hold, a few MB on each side."""


@dataclass(frozen=True)
class Crowded:
    """A service with a low limit of connections."""

    client: ServedClient
    token: dict[str, str]

    def stop(self) -> httpx2.Response:
        """Stop the arm over a new connection."""
        return httpx2.post(f"{self.client.base_url}/api/cell/stop", headers=self.token, timeout=PATIENCE_S)

    def follow(self) -> socket.socket:
        """Open an event stream."""
        head = f"GET /api/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: {self.token['Authorization']}\r\n\r\n"
        return open_connection(port_of(self.client), head.encode())


@pytest.fixture(scope="module")
def service(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Crowded]:
    data = tmp_path_factory.mktemp("crowded")
    token = bearer(add_token(data, "ann", "viewer"))
    with without_recognition(serve, data, limits={"event_streams_each": LIMIT}) as client:
        yield Crowded(client, token)


@pytest.fixture
def crowded(service: Crowded, monkeypatch: pytest.MonkeyPatch) -> Crowded:
    """Return the service with its limit set and no warning logged."""
    monkeypatch.setattr(connection, "MAX_CONNECTIONS", LIMIT)
    monkeypatch.setattr(GuardedConnection, "_last_warning_s", float("-inf"))
    return service


def open_connection(port: int, sent: bytes) -> socket.socket:
    """Open a connection and send something; if it is a request, wait for the start of its answer."""
    one = connect(port)
    one.sendall(sent)
    if sent.endswith(b"\r\n\r\n"):
        assert one.recv(64).startswith(b"HTTP/1.1 200 ")
    return one


def is_open(one: socket.socket) -> bool:
    """Return whether the service has not closed the connection."""
    one.settimeout(0.0)
    try:
        while one.recv(65536):
            pass
    except BlockingIOError:
        return True
    except ConnectionResetError:
        pass
    return False


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name == connection.__name__]


@pytest.mark.parametrize("sent", [b"", b"GET /heal", HEALTH], ids=["nothing", "half-a-head", "keep-alive"])
def test_the_longest_idle_connections_are_closed_first(
    crowded: Crowded, sent: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with ExitStack() as open_ones, caplog.at_level(logging.WARNING):
        streams = [open_ones.enter_context(crowded.follow()) for _ in range(2)]
        silent = [open_ones.enter_context(open_connection(port_of(crowded.client), sent)) for _ in range(3 * LIMIT)]
        assert crowded.stop().status_code == 200
        # The streams and the stop use three connections of the limit.
        remaining = LIMIT - 3
        wait_until(lambda: not any(is_open(one) for one in silent[:-remaining]))
        assert all(is_open(one) for one in silent[-remaining:])
        assert all(is_open(one) for one in streams), "connections with a request stay open"
    (one,) = warnings(caplog)
    assert "idle ones are closed" in one


def test_public_requests_do_not_block_a_stop(crowded: Crowded) -> None:
    with ExitStack() as open_ones:
        for _ in range(LIMIT):
            open_ones.enter_context(open_connection(port_of(crowded.client), LARGE))
        assert crowded.stop().status_code == 200


def test_no_request_is_aborted_for_a_new_connection(crowded: Crowded, caplog: pytest.LogCaptureFixture) -> None:
    with ExitStack() as open_ones:
        streams = [open_ones.enter_context(crowded.follow()) for _ in range(LIMIT)]
        with connect(port_of(crowded.client)) as one_more:
            assert read_all(one_more) == b""
        assert all(is_open(one) for one in streams)
        (one,) = warnings(caplog)
        assert "new ones are closed" in one
        streams[0].close()
        slots = crowded.client.app.state.context.streams
        wait_until(lambda: slots.open < LIMIT)
        assert crowded.stop().status_code == 200


def test_connections_use_at_most_half_of_the_files(monkeypatch: pytest.MonkeyPatch) -> None:
    for files, limit, waiting in ((256, 128, 32), (1024, 512, 128), (1 << 20, 512, 2048)):
        monkeypatch.setattr(connection, "open_file_limit", lambda files=files: files)
        assert (connection_limit(), backlog()) == (limit, waiting)


def test_the_file_limit_is_raised_to_the_maximum() -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft - 1, hard))
        assert open_file_limit() == soft - 1
        raise_file_limit()
        assert open_file_limit() == hard
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_many_connections_do_not_block_a_stop_with_few_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
            open_ones.enter_context(open_connection(client.base_url.port or 80, HEALTH))
        stop = httpx2.post(f"{client.base_url}/api/cell/stop", headers=token, timeout=PATIENCE_S)
        assert stop.status_code == 200
        text = log.read_text()
        assert text.count("connections are open, which is the limit: idle ones are closed") == 1
        assert "out of system resource" not in text
        assert "Traceback" not in text
