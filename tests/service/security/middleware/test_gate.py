"""The gate refuses a request before any of its body is read."""

import json

import pytest

from tests.service.conftest import ServedClient
from tests.service.observed_problems import observe_problem
from tests.service.security.conftest import connect, port_of, read_all


@pytest.mark.problem("bad-request")
def test_a_request_with_two_lengths_is_refused_and_its_connection_closed(client: ServedClient) -> None:
    head = b"POST /api/cell/stop HTTP/1.1\r\nHost: localhost\r\nX-Pointchain: test\r\n"
    hidden = b"GET /api/scans HTTP/1.1\r\nHost: localhost\r\n\r\n"
    lengths = f"Content-Length: {5 + len(hidden)}\r\nTransfer-Encoding: chunked\r\n\r\n".encode()
    with connect(port_of(client)) as connection:
        connection.sendall(head + lengths + b"0\r\n\r\n" + hidden)
        answer, _, body = read_all(connection).partition(b"\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert b"connection: close" in answer.lower()
    document = json.loads(body)  # one answer only
    observe_problem(document)
    assert document["detail"] == "the request has Content-Length and Transfer-Encoding: send one of them"
