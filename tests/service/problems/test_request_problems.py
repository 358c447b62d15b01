"""Problems of requests before a route, and of uploads: each is provoked over a real socket."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx2
import pytest

from service.api.routes.recordings import MAX_UPLOADS
from service.security.audit.reader import read_audit
from service.security.middleware import install
from service.security.middleware.body_limits import BodyTimeouts
from service.storage.idempotency_keys import Key
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.observed_problems import observe_problem
from tests.service.security.conftest import connect, port_of, read_all, without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def quick(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """Yield a client of a service that waits only shortly for bodies."""
    quick_timeouts = BodyTimeouts(chunk_s=0.3, request_s=0.6)
    with pytest.MonkeyPatch.context() as patch, ExitStack() as running:
        patch.setattr(install, "BodyTimeouts", lambda: quick_timeouts)
        client = running.enter_context(without_recognition(serve, tmp_path_factory.mktemp("data")))
        yield client


def send(client: ServedClient, request: bytes) -> None:
    """Send bytes, read the answer until the service closes the connection, and keep its problem."""
    with connect(port_of(client)) as connection:
        connection.sendall(request)
        head, _, body = read_all(connection).partition(b"\r\n\r\n")
    document = json.loads(body)
    assert head.startswith(f"HTTP/1.1 {document['status']} ".encode())
    assert b"application/problem+json" in head
    observe_problem(document)


@pytest.mark.problem("bad-request")
def test_a_request_without_a_host_is_bad(client: ServedClient) -> None:
    send(client, b"GET /api/cell HTTP/1.1\r\n\r\n")


@pytest.mark.problem("too-slow")
def test_a_body_that_does_not_arrive_is_too_slow(quick: ServedClient) -> None:
    send(quick, b"POST /api/scans HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n")


@pytest.mark.problem("headers-too-large")
def test_headers_of_more_than_16_kb_are_refused(client: ServedClient, assert_problem: AssertProblem) -> None:
    headers = {f"X-Much-{number}": "a" * 1000 for number in range(17)}
    assert_problem(client.get("/api/cell", headers=headers), 431, "headers-too-large")


@pytest.mark.problem("not-found")
def test_an_address_without_a_call_is_not_found(client: ServedClient, assert_problem: AssertProblem) -> None:
    assert_problem(client.get("/api/none"), 404, "not-found")


@pytest.mark.problem("idempotency-pending")
def test_a_second_request_with_a_pending_key_is_refused(client: ServedClient, assert_problem: AssertProblem) -> None:
    with client.app.state.context.keys.first_use(Key("local", "pending", ""), time.monotonic()):
        answer = client.post("/api/scans", json={"mode": "live"}, headers={"Idempotency-Key": "pending"})
    assert_problem(answer, 409, "idempotency-pending")


@pytest.mark.problem("busy")
def test_uploads_and_a_locked_database_are_busy(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, assert_problem: AssertProblem
) -> None:
    monkeypatch.setattr("service.storage.database.BUSY_S", 0.0)
    head = b"POST /api/recordings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabc"
    with without_recognition(serve, tmp_path) as client, ExitStack() as uploads:
        for _ in range(MAX_UPLOADS):
            uploads.enter_context(connect(port_of(client))).sendall(head)
        service = client.app.state.context
        wait_until(lambda: service.uploads.borrowed_tokens == MAX_UPLOADS)
        assert_problem(client.post("/api/recordings", content=b"abc"), 503, "busy")


@pytest.mark.problem("storage-full")
def test_too_little_free_space_is_refused_with_numbers(
    serve: Serve, tmp_path: Path, assert_problem: AssertProblem
) -> None:
    with without_recognition(serve, tmp_path, limits={"min_free_bytes": 1 << 62}) as client:
        assert_problem(client.post("/api/recordings", content=b"abc"), 507, "storage-full")


def test_an_upload_that_ends_early_is_in_the_audit_log(serve: Serve, tmp_path: Path) -> None:
    """The sender has gone, so nobody receives the answer."""
    with without_recognition(serve, tmp_path) as client:
        with connect(port_of(client)) as connection:
            connection.sendall(b"POST /api/recordings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabc")
        wait_until(
            lambda: any(
                entry.result == "upload-incomplete" for entry in read_audit(tmp_path, None, None, None, limit=10)
            )
        )
