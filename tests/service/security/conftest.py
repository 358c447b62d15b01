"""A service with a token for each role, and raw connections to a service."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.jobs.manager import Jobs
from service.security.auth.caller import ROLES
from service.security.auth.tokens import add_token
from service.server.uvicorn_server import Server
from tests.service.conftest import PATIENCE_S, Serve, ServedClient, wait_until


@dataclass(frozen=True)
class Guarded:
    """A service with a token for each role."""

    data: Path
    client: ServedClient
    """Client without a token."""
    headers: dict[str, dict[str, str]]
    """Header with the token of each role."""


@pytest.fixture(scope="session")
def guarded(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """Start a service with a token for each role. The token has the name of its role."""
    data = tmp_path_factory.mktemp("guarded")
    headers = {role: bearer(add_token(data, role, role)) for role in ROLES}
    with without_recognition(serve, data, limits={"request_bytes": 4096, "upload_bytes": 2_000_000}) as client:
        yield Guarded(data, client, headers)


@contextmanager
def without_recognition(serve: Serve, data: Path, **settings: Any) -> Iterator[ServedClient]:
    """Start a service without a recognition process, whose start would take longer than the tests."""

    def do_nothing(*_: object) -> None: ...

    with ExitStack() as running:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Jobs, "_prepare", do_nothing)
            client = running.enter_context(serve(data, **settings))
            client.app.state.context.jobs._prepare = do_nothing
        yield client


def bearer(token: str) -> dict[str, str]:
    """Return the header with a token."""
    return {"Authorization": f"Bearer {token}"}


ServeApp = Callable[..., AbstractContextManager[int]]


@pytest.fixture
def serve_app() -> ServeApp:
    """`serve_app(app, **options of uvicorn)`: serve an ASGI application on a free port by the service's server."""

    @contextmanager
    def serving(app: Any, **options: Any) -> Iterator[int]:
        server = Server(app, port=0, log_level="warning", log_config=None, lifespan="off", **options)
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            wait_until(lambda: server.started or not thread.is_alive())
            yield server.servers[0].sockets[0].getsockname()[1]
        finally:
            server.should_exit = True
            thread.join()

    return serving


def connect(port: int) -> socket.socket:
    """Open a TCP connection."""
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)


def port_of(client: httpx2.Client) -> int:
    """Return the port of the client's service."""
    assert client.base_url.port is not None
    return client.base_url.port


def read_all(connection: socket.socket) -> bytes:
    """Read until the other side closes the connection."""
    found = b""
    try:
        while part := connection.recv(65536):
            found += part
    except ConnectionResetError:
        pass  # the other side closed with unread data
    return found
