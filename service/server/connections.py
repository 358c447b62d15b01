"""One connection, by uvicorn's h11 protocol: who says nothing for long, or half a request, does not keep it, and where
there are too many, who asks for nothing makes room."""

import asyncio
import itertools
import json
import logging
import math
import time
from typing import Any, ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from service.logs.request_time import having_come
from service.problems.document import MEDIA_TYPE, problem_document
from service.security.auth.caller import is_nobodys
from service.security.middleware.headers import UNEXPECTED
from service.server.file_limit import open_files

log = logging.getLogger(__name__)

HEAD_S = 10.0
"""For a request's head to be there, from its first byte on; from the beginning of the connection for the first."""
MOST = 512
"""So many connections are open at a time, and never more than take half of the files that may be open."""
TELL_S = 60.0
"""That there are too many is told at most once in so long."""

_turns = itertools.count()
"""What came first: by a clock, many begin at the same moment."""


def most_connections() -> int:
    """So many are kept; the other half of the files is for the store, and for those that come while some are closed."""
    return min(MOST, open_files() // 2)


def backlog() -> int:
    """So many wait to be taken, which all are in one turn of the loop: open, before one is closed for each."""
    return min(2048, open_files() // 8)


class GuardedConnection(H11Protocol):
    """Closes a connection on which the head of a request, or a body that nobody reads any more, takes too long.

    Between two requests it stays open for uvicorn's `timeout_keep_alive`, unless there are too many: whoever wants to
    stop the arm must come in, also while somebody without a token holds as many as he can.
    """

    _told_s: ClassVar[float] = -math.inf
    """When it was last told that there are too many."""

    def __init__(self, *args: Any, head_s: float = HEAD_S, **options: Any) -> None:
        """`args` and `options` as uvicorn has them."""
        super().__init__(*args, **options)
        self._head_s = head_s
        self._waiting: asyncio.TimerHandle | None = None
        self._silent_since = 0
        """The turn at which it began, or its last request ended."""
        self._came_s: float | None = None
        """When what waits behind the request under way came, if anything does."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begins to wait for the first head, if there is room."""
        super().connection_made(transport)
        self._silent_since = next(_turns)
        if len(self.connections) > most_connections():
            self._make_room()
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Waits on for what is incomplete, from its first byte."""
        super().data_received(data)
        if self._came_s is None and self._has_more:
            self._came_s = time.monotonic()
        if self._between_requests or self._unread:
            self._wait()
        else:
            self._wait_no_more()

    def on_response_complete(self) -> None:
        """What came of the next request meanwhile, or is still to come of this one's body, is waited for."""
        self._silent_since = next(_turns)
        with having_come(self._came_s):  # the next one, which may be a scan that was asked for before a stop
            super().on_response_complete()
        if not self._has_more:
            self._came_s = None
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

    @property
    def _under_way(self) -> bool:
        """A request is there, and its answer is not whole yet."""
        return self.cycle is not None and not self.cycle.response_complete

    @property
    def _has_more(self) -> bool:
        """Something of a next request came before the answer to the one under way is whole."""
        return self._under_way and self.conn.their_state is h11.DONE and bool(self.conn.trailing_data[0])

    def _make_room(self) -> None:
        """Closes who has asked for nothing for longest; else who needs no token for what he takes; else this one."""
        others = [one for one in self.connections if isinstance(one, GuardedConnection) and one is not self]
        idle = [one for one in others if not one._under_way]
        leaving = min(idle or filter(_serves_anybody, others), key=lambda one: one._silent_since, default=self)
        self.connections.discard(leaving)
        leaving.transport.abort()  # to close it would be to wait until it has taken all that it was sent
        now_s = self.loop.time()
        if now_s >= GuardedConnection._told_s + TELL_S:
            GuardedConnection._told_s = now_s
            log.warning(
                "%d connections are open, and more come: %s",
                len(self.connections),
                "all are at work, so that new ones are closed" if leaving is self else "idle ones are closed for them",
            )

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
            self._answer_problem("too-slow", "the request's head comes too slowly")
        else:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP is told so by a problem document, as everything else."""
        self._answer_problem("bad-request", "this is no HTTP/1.1 request, or its head is too large")

    def _answer_problem(self, slug: str, detail: str) -> None:
        document = problem_document(slug, detail)
        body = json.dumps(document).encode()
        headers = UNEXPECTED | {"Content-Type": MEDIA_TYPE, "Content-Length": str(len(body))}
        try:
            for event in (
                h11.Response(status_code=document["status"], headers=[(k.lower(), v) for k, v in headers.items()]),
                h11.Data(data=body),
                h11.EndOfMessage(),
            ):
                self.transport.write(self.conn.send(event) or b"")
        except h11.LocalProtocolError:
            self.logger.debug("an answer was under way already")
        self.transport.close()


def _serves_anybody(connection: GuardedConnection) -> bool:
    return is_nobodys(connection.cycle.scope.get("state", {}))


PROTOCOL: dict[str, Any] = {
    "http": GuardedConnection,
    "ws": "none",  # nothing here speaks it
    "proxy_headers": False,  # who asks is whoever is connected, not whom he names
    "server_header": False,
}
"""What uvicorn is to use."""
