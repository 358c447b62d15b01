"""HEAD is answered at each address that has a GET, with the same headers and without a body."""

from typing import Any

import pytest

from service.security.auth.roles import MIN_ROLE
from tests.service.conftest import ServedClient, wait_until
from tests.service.security.conftest import connect, port_of

STREAMS = {"GET /api/events", "GET /api/scans/{id}/events"}
SAME = ("content-type", "content-length", "etag", "cache-control", "location")


@pytest.mark.parametrize("call", sorted({name for name in MIN_ROLE if name.startswith("GET ")} - STREAMS))
def test_head_has_the_headers_of_get(client: ServedClient, scan: dict[str, Any], call: str) -> None:
    path = call.removeprefix("GET ").replace("/recordings/{id}", f"/recordings/{scan['recording']}")
    path = path.replace("{id}", scan["id"]).replace("{index}", "1").replace("{path:path}", "x")
    head, answer = client.head(path), client.get(path)
    assert (head.status_code, head.content) == (answer.status_code, b"")
    assert set(head.headers) == set(answer.headers)
    if call != "GET /metrics":  # they have changed in between
        assert [head.headers.get(name) for name in SAME] == [answer.headers.get(name) for name in SAME]


def test_head_of_an_event_stream_ends_at_once(client: ServedClient) -> None:
    streams = client.app.state.context.streams
    open_before = streams.open
    with connect(port_of(client)) as connection:
        # the second answer comes on the same connection, so the first one has ended
        connection.sendall(
            b"HEAD /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n"
            b"HEAD /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        )
        with connection.makefile("rb") as file:
            first, second, rest = file.read().split(b"\r\n\r\n")
    assert first.startswith(b"HTTP/1.1 200 ")
    assert b"text/event-stream" in first
    assert second.startswith(b"HTTP/1.1 200 ")
    assert rest == b""
    wait_until(lambda: streams.open == open_before)
