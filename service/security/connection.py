"""One connection, by uvicorn's h11 protocol: who says nothing for long, or half a request, does not keep it."""

import asyncio
import json
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.problems import MEDIA_TYPE, problem_document
from service.security.headers import UNEXPECTED

HEAD_S = 10.0
"""For a request's head to be there, from its first byte on; from the beginning of the connection for the first."""


class GuardedConnection(H11Protocol):
    """Closes a connection on which the head of a request, or a body that nobody reads any more, takes too long.

    Between two requests it stays open for uvicorn's `timeout_keep_alive`.
    """

    def __init__(self, *args: Any, head_s: float = HEAD_S, **options: Any) -> None:
        """`args` and `options` as uvicorn has them."""
        super().__init__(*args, **options)
        self._head_s = head_s
        self._waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begins to wait for the first head."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Waits on for what is incomplete, from its first byte."""
        super().data_received(data)
        if self._between_requests or self._unread:
            self._wait()
        else:
            self._wait_no_more()

    def on_response_complete(self) -> None:
        """What came of the next request meanwhile, or is still to come of this one's body, is waited for."""
        super().on_response_complete()
        if self._unread or (self._between_requests and self.conn.trailing_data[0]):
            self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Ends waiting."""
        self._wait_no_more()
        super().connection_lost(exc)

    @property
    def _between_requests(self) -> bool:
        return self.conn.their_state is h11.IDLE

    @property
    def _unread(self) -> bool:
        """The answer is sent and the rest of the request's body is read past."""
        return self.conn.their_state is h11.SEND_BODY and self.cycle.response_complete

    def _wait(self) -> None:
        if self._waiting is None and not self.transport.is_closing():
            self._waiting = self.loop.call_later(self._head_s, self._too_slow)

    def _wait_no_more(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _too_slow(self) -> None:
        self._waiting = None
        if self.transport.is_closing():
            return
        if self._between_requests and self.conn.trailing_data[0]:
            self._answer(408, "too-slow", "the request's head comes too slowly")
        else:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP is told so by a problem document, as everything else."""
        self._answer(400, "bad-request", "this is no HTTP/1.1 request, or its head is too large")

    def _answer(self, status: int, slug: str, detail: str) -> None:
        body = json.dumps(problem_document(status, slug, detail)).encode()
        headers = UNEXPECTED | {"Content-Type": MEDIA_TYPE, "Content-Length": str(len(body)), "Connection": "close"}
        try:
            for event in (
                h11.Response(status_code=status, headers=[(k.lower(), v) for k, v in headers.items()]),
                h11.Data(data=body),
                h11.EndOfMessage(),
            ):
                self.transport.write(self.conn.send(event) or b"")
        except h11.LocalProtocolError:
            self.logger.debug("an answer was under way already")
        self.transport.close()


PROTOCOL: dict[str, Any] = {
    "http": GuardedConnection,
    "ws": "none",  # nothing here speaks it
    "proxy_headers": False,  # who asks is whoever is connected, not whom he names
    "server_header": False,
}
"""What uvicorn is to use."""
