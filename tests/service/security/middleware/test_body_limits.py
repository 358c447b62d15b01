"""The limits of the size of a request, and of the time in which it must arrive."""

import asyncio
import socket
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import httpx2
import pytest
from fastapi import FastAPI, Request
from starlette.types import Message, Receive, Scope, Send

from service.api.problem_handlers import install_problem_handlers
from service.problems.problem_error import ProblemError
from service.security.middleware.body_limits import BodyLimits, BodyTimeouts
from service.server.connections import GuardedConnection
from tests.service.conftest import ServedClient, wait_until
from tests.service.security.conftest import Guarded, ServeApp, connect, port_of, read_all

AssertProblem = Callable[[httpx2.Response, int, str], str]

QUICK = BodyTimeouts(chunk_s=0.3, request_s=0.6, upload_grace_s=0.4, upload_min_bytes_per_s=10_000)
PATIENT = replace(QUICK, chunk_s=30.0, upload_grace_s=30.0)
"""Timeouts that an upload keeps on a busy machine too. That of other bodies is as short."""


def echo(timeouts: BodyTimeouts = QUICK) -> FastAPI:
    """Return an application that answers with the size of the body."""
    app = FastAPI()
    app.add_middleware(BodyLimits, request_bytes=1000, upload_bytes=100_000, upload_path="/upload", timeouts=timeouts)
    install_problem_handlers(app)

    @app.post("/{anything}")
    async def body_size(request: Request) -> int:
        return len(await request.body())

    return app


def send_slowly(port: int, head: str, part: bytes, pause_s: float, times: int) -> bytes:
    """Send a head and then a part repeatedly until the service answers; return the answer."""
    with connect(port) as connection:
        connection.sendall(head.encode())
        connection.settimeout(pause_s)
        found = b""
        for _ in range(times):
            try:
                found += connection.recv(65536)
                break
            except TimeoutError:
                connection.sendall(part)
        connection.settimeout(60)
        return found + read_all(connection)


def head_of(path: str, length: int | None) -> str:
    size = "Transfer-Encoding: chunked" if length is None else f"Content-Length: {length}"
    return f"POST {path} HTTP/1.1\r\nHost: localhost\r\n{size}\r\n\r\n"


def test_a_slow_body_is_refused(serve_app: ServeApp) -> None:
    with serve_app(echo()) as port:
        silent = send_slowly(port, head_of("/x", 100), b"", 0.1, 100)
        steady = send_slowly(port, head_of("/x", 1000), b"a", 0.1, 100)  # a byte each time, which would take 100 s
        chunked = send_slowly(port, head_of("/x", None), b"1\r\na\r\n", 0.1, 100)
        upload = send_slowly(port, head_of("/upload", 90_000), b"a" * 50, 0.05, 1000)  # 1 kB/s
        for answer in (silent, steady, chunked, upload):
            assert answer.startswith(b"HTTP/1.1 408 "), answer
            assert b"urn:pointchain:too-slow" in answer


def test_an_upload_may_take_longer_than_other_bodies(serve_app: ServeApp) -> None:
    with serve_app(echo(PATIENT)) as port, connect(port) as connection:
        connection.sendall(head_of("/upload", 20_000).encode())
        for _ in range(10):
            time.sleep(PATIENT.request_s / 5)
            connection.sendall(b"a" * 2000)
        assert b"200 OK" in connection.recv(65536)


def test_an_idle_connection_after_a_body_is_not_slow(serve_app: ServeApp) -> None:
    with serve_app(echo()) as port, httpx2.Client(base_url=f"http://127.0.0.1:{port}") as client:
        for _ in range(2):
            assert client.post("/x", content=b"abc").json() == 3
            time.sleep(2 * QUICK.request_s)


def test_the_end_of_a_connection_has_no_timeout() -> None:
    """An event stream waits for it after the body has arrived."""
    seen = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        seen.append((await receive())["type"])
        seen.append((await receive())["type"])

    async def run() -> None:
        messages: list[Message] = [{"type": "http.request", "body": b"", "more_body": False}]

        async def receive() -> Message:
            if messages:
                return messages.pop()
            await asyncio.sleep(2 * QUICK.request_s)
            return {"type": "http.disconnect"}

        async def send(_: Message) -> None: ...

        limits = BodyLimits(app, 1000, 1000, "/upload", QUICK)
        await limits({"type": "http", "path": "/x", "headers": []}, receive, send)

    asyncio.run(run())
    assert seen == ["http.request", "http.disconnect"]


def test_after_the_start_of_the_answer_a_bad_body_counts_as_a_disconnect() -> None:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        with pytest.raises(ProblemError):
            await receive()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        assert await receive() == {"type": "http.disconnect"}

    async def nothing(*_: Message) -> Message:
        return {"type": "http.request", "body": b"a" * 2000, "more_body": True}

    for length in (b"2000", b"5"):
        scope = {"type": "http", "path": "/x", "headers": [(b"content-length", length)]}
        asyncio.run(BodyLimits(app, 1000, 1000, "/upload", QUICK)(scope, nothing, nothing))  # type: ignore[arg-type]


def test_the_body_of_an_unknown_caller_is_not_read(guarded: Guarded) -> None:
    with connect(port_of(guarded.client)) as connection:
        connection.sendall(head_of("/api/recordings", 10 * 2**30).encode())  # without any of the body
        answer = read_all(connection)
    assert answer.startswith(b"HTTP/1.1 401 ")


@pytest.mark.parametrize("headers", [{"Content-Encoding": "gzip"}, {"Content-Type": "multipart/form-data; boundary=b"}])
@pytest.mark.parametrize("path", ["/api/scans", "/api/recordings"])
@pytest.mark.problem("encoded-body")
def test_an_encoded_body_is_refused_by_name(
    client: ServedClient, assert_problem: AssertProblem, path: str, headers: dict[str, str]
) -> None:
    detail = assert_problem(client.post(path, content=b"abc", headers=headers), 415, "encoded-body")
    assert "as it is" in detail


def test_json_with_another_content_type_is_refused_by_name(client: ServedClient, assert_problem: AssertProblem) -> None:
    form = {"Content-Type": "application/x-www-form-urlencoded"}  # the default of curl
    answer = client.post("/api/scans", content=b'{"mode": "live"}', headers=form)
    assert "send application/json" in assert_problem(answer, 422, "invalid-request")
    wrong = client.post("/api/scans", json={"mode": "alive"})
    assert "application/json" not in assert_problem(wrong, 422, "invalid-request")
    # An empty body, as curl sends it with -X POST -d "".
    assert client.post("/api/cell/stop", content=b"", headers=form).status_code == 200


@pytest.mark.problem("target-too-long")
def test_a_long_address_and_large_headers_are_refused(client: ServedClient, assert_problem: AssertProblem) -> None:
    assert_problem(client.get("/api/scans?before=" + "a" * 3000), 414, "target-too-long")
    assert_problem(client.get("/api/scans/" + "a" * 3000), 414, "target-too-long")
    assert_problem(client.get("/api/scans?before=" + "a" * 1900), 422, "invalid-request")
    assert client.get("/api/cell", headers={"X-Much": "a" * 15_000}).status_code == 200
    many = {f"X-Much-{k}": "a" * 1000 for k in range(20)}
    assert client.get("/api/cell", headers=many).status_code in (400, 431)
    with connect(port_of(client)) as connection:
        connection.sendall(b"GET /api/cell HTTP/1.1\r\nHost: localhost\r\nX-Endless: ")
        try:
            for _ in range(100):
                connection.sendall(b"a" * 1000)
        except (BrokenPipeError, ConnectionResetError):
            pass
        assert read_all(connection).startswith(b"HTTP/1.1 400 ")


class ShortTimeout(GuardedConnection):
    """A connection with a short timeout."""

    HEADER_S = 0.4

    def __init__(self, **options: Any) -> None:
        super().__init__(header_timeout_s=self.HEADER_S, **options)


def test_an_incomplete_head_does_not_keep_a_connection(serve_app: ServeApp) -> None:
    with serve_app(echo(), http=ShortTimeout) as port:
        with connect(port) as connection:  # nothing at all
            assert read_all(connection) == b""
        slow = send_slowly(port, "POST /x HTTP/1.1\r\nHost: localhost\r\n", b"X-A: b\r\n", 0.1, 100)
        assert slow.startswith(b"HTTP/1.1 408 ")
        assert b"urn:pointchain:too-slow" in slow
        empty = send_slowly(port, "\r\n", b"\r\n", 0.1, 100)
        assert empty == b"" or empty.startswith(b"HTTP/1.1 4")
        # The same after an answered request, and pipelined after one.
        whole = "POST /x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n"
        with connect(port) as connection:
            connection.sendall(whole.encode())
            assert b"200 OK" in connection.recv(65536)
            connection.sendall(b"GET /")
            assert b"408" in read_all(connection)
        piped = send_slowly(port, whole + "GET / HT", b"", 0.1, 100)
        assert b"200 OK" in piped
        assert b"HTTP/1.1 408 " in piped


def test_a_connection_stays_open_between_requests(serve_app: ServeApp) -> None:
    request = b"POST /x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2\r\n\r\nab"
    with serve_app(echo(), http=ShortTimeout) as port, connect(port) as connection, connection.makefile("rb") as file:
        for _ in range(3):
            connection.sendall(request)
            assert b"200 OK" in file.readline()
            while file.readline().strip():
                pass
            assert file.read(1) == b"2"
            time.sleep(2 * ShortTimeout.HEADER_S)


def test_an_unread_body_does_not_keep_a_connection(serve_app: ServeApp) -> None:
    app = FastAPI()

    @app.post("/x")
    async def ignore_body() -> None: ...

    with serve_app(app, http=ShortTimeout) as port, connect(port) as connection:
        connection.sendall(head_of("/x", 10_000).encode())
        assert b"200 OK" in connection.recv(65536)
        wait_until(lambda: not accepts(connection, b"a"))


def accepts(connection: socket.socket, data: bytes) -> bool:
    """Return whether the other side still accepts data."""
    try:
        connection.sendall(data)
    except (BrokenPipeError, ConnectionResetError):
        return False
    return True


def test_invalid_http_gets_a_problem_document(client: ServedClient) -> None:
    tls = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\0" * 64 + b"\r\n\r\n"
    for nonsense in (tls, b"GET  /\r\n\r\n", b"\0" * 100 + b"\r\n\r\n"):
        with connect(port_of(client)) as connection:
            connection.sendall(nonsense)
            answer = read_all(connection)
        assert answer.startswith(b"HTTP/1.1 400 ")
        assert b"application/problem+json" in answer
    assert client.get("/healthz").status_code == 200
