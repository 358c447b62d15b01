"""Connections by uvicorn's h11 protocol, with a request header timeout and a limit of open connections.

A client that is silent, or that sends half a request, cannot keep its connection. If too many connections are open,
those without a request are closed first.
"""

import asyncio
import itertools
import json
import logging
import math
import time
from typing import Any, ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.logs.request_time import request_received_at
from service.problems.document import MEDIA_TYPE, problem_document
from service.security.auth.caller import is_anonymous
from service.security.middleware.headers import UNEXPECTED_ERROR_HEADERS
from service.server.file_limit import open_file_limit

log = logging.getLogger(__name__)

HEADER_TIMEOUT_S = 10.0
"""Request header timeout, from the first byte on.

For the first request, it begins with the connection.
"""
MAX_CONNECTIONS = 512
"""Maximum number of open connections. They never use more than half of the files that may be open."""
WARNING_INTERVAL_S = 60.0
"""Minimum time between two warnings about too many connections."""

_order = itertools.count()
"""Order of events on all connections. A clock does not suffice: many connections begin at the same time."""


def connection_limit() -> int:
    """Return the maximum number of open connections.

    The other half of the files is for the store, and for new connections that arrive while others are closed.
    """
    return min(MAX_CONNECTIONS, open_file_limit() // 2)


def backlog() -> int:
    """Return the maximum number of connections that wait to be accepted.

    One turn of the event loop accepts all of them, so that all are open before another is closed for each.
    """
    return min(2048, open_file_limit() // 8)


class GuardedConnection(H11Protocol):
    """Closes a connection if a request header, or a body that is no longer read, takes too long to arrive.

    Between two requests, a connection stays open for uvicorn's `timeout_keep_alive`, unless there are too many. A
    request to stop the arm must get through even if a client without a token holds as many connections as it can.
    """

    _last_warning_s: ClassVar[float] = -math.inf
    """Time of the last warning about too many connections, seconds of the event loop."""

    def __init__(self, *args: Any, header_timeout_s: float = HEADER_TIMEOUT_S, **options: Any) -> None:
        """Create the protocol of one connection.

        Args:
            args: Arguments of uvicorn.
            header_timeout_s: Request header timeout, seconds.
            options: Options of uvicorn.
        """
        super().__init__(*args, **options)
        self._header_timeout_s = header_timeout_s
        self._timer: asyncio.TimerHandle | None = None
        self._idle_since = 0
        """Position in `_order` at which the connection began, or its last request ended."""
        self._pipelined_at_s: float | None = None
        """Monotonic time at which a pipelined request arrived, or None if none waits."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timeout of the first request header; close a connection if too many are open."""
        super().connection_made(transport)
        self._idle_since = next(_order)
        if len(self.connections) > connection_limit():
            self._evict_connection()
        self._start_timeout()

    def data_received(self, data: bytes) -> None:
        """Keep the timeout running while a header or an unread body is incomplete; it began with the first byte."""
        super().data_received(data)
        if self._pipelined_at_s is None and self._has_pipelined_data:
            self._pipelined_at_s = time.monotonic()
        if self._between_requests or self._discards_body:
            self._start_timeout()
        else:
            self._cancel_timeout()

    def on_response_complete(self) -> None:
        """Start the timeout for the rest of this request's body, or for the rest of a pipelined header."""
        self._idle_since = next(_order)
        # the pipelined request begins here; it may be a scan that was requested before a stop
        with request_received_at(self._pipelined_at_s):
            super().on_response_complete()
        if not self._has_pipelined_data:
            self._pipelined_at_s = None
        if self._discards_body or (self._between_requests and self.conn.trailing_data[0]):
            self._start_timeout()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timeout."""
        self._cancel_timeout()
        super().connection_lost(exc)

    @property
    def _between_requests(self) -> bool:
        return self.conn.their_state is h11.IDLE

    @property
    def _discards_body(self) -> bool:
        """Whether the answer is complete, and the rest of the request's body is read only to be discarded."""
        return self.conn.their_state is h11.SEND_BODY and self.cycle.response_complete

    @property
    def _has_request(self) -> bool:
        """Whether there is a request whose answer is not complete."""
        return self.cycle is not None and not self.cycle.response_complete

    @property
    def _has_pipelined_data(self) -> bool:
        """Whether data of a further request arrived before the answer to the current one is complete."""
        return self._has_request and self.conn.their_state is h11.DONE and bool(self.conn.trailing_data[0])

    def _evict_connection(self) -> None:
        """Close the connection that has been idle longest; else one with a public request; else this one."""
        others = [one for one in self.connections if isinstance(one, GuardedConnection) and one is not self]
        idle = [one for one in others if not one._has_request]
        anonymous = (one for one in others if is_anonymous(one.cycle.scope.get("state", {})))
        evicted = min(idle or anonymous, key=lambda one: one._idle_since, default=self)
        self.connections.discard(evicted)
        evicted.transport.abort()  # `close` would wait until the client has received everything
        now_s = self.loop.time()
        if now_s >= GuardedConnection._last_warning_s + WARNING_INTERVAL_S:
            GuardedConnection._last_warning_s = now_s
            log.warning(
                "%d connections are open, which is the limit: %s",
                len(self.connections),
                "all of them have requests, so new ones are closed" if evicted is self else "idle ones are closed",
            )

    def _start_timeout(self) -> None:
        if self._timer is None and not self.transport.is_closing():
            self._timer = self.loop.call_later(self._header_timeout_s, self._on_timeout)

    def _cancel_timeout(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _on_timeout(self) -> None:
        self._timer = None
        if self.transport.is_closing():
            return
        if self._between_requests and self.conn.trailing_data[0]:
            self._send_problem("too-slow", "the request header arrives too slowly; send it at once")
        else:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Answer what is not HTTP with a problem document, as for every other error."""
        self._send_problem("bad-request", "this is not an HTTP/1.1 request, or its header is too large")

    def _send_problem(self, slug: str, detail: str) -> None:
        document = problem_document(slug, detail)
        body = json.dumps(document).encode()
        headers = UNEXPECTED_ERROR_HEADERS | {"Content-Type": MEDIA_TYPE, "Content-Length": str(len(body))}
        try:
            for event in (
                h11.Response(status_code=document["status"], headers=[(k.lower(), v) for k, v in headers.items()]),
                h11.Data(data=body),
                h11.EndOfMessage(),
            ):
                self.transport.write(self.conn.send(event) or b"")
        except h11.LocalProtocolError:
            self.logger.debug("another answer had already begun")
        self.transport.close()


PROTOCOL: dict[str, Any] = {
    "http": GuardedConnection,
    "ws": "none",  # no route uses WebSocket
    "proxy_headers": False,  # the client is the peer of the connection, not the one that a header names
    "server_header": False,
}
"""Protocol options of uvicorn."""
