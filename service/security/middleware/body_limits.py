"""Middleware that limits the size of bodies and the time in which they must arrive.

The bytes are counted as they arrive, because a declared length may be missing or wrong.
"""

import asyncio
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems.problem_error import ProblemError


@dataclass(frozen=True)
class BodyTimeouts:
    """Timeouts for bodies, seconds. Only the waiting is counted, not the processing of what has arrived."""

    chunk_s: float = 10.0
    """Timeout for the next part of a body."""
    request_s: float = 15.0
    """Timeout for a whole body, except that of an upload."""
    upload_grace_s: float = 15.0
    """Time after which the minimum rate of an upload is enforced."""
    upload_min_bytes_per_s: float = 10_000.0
    """Minimum average rate of an upload."""


class BodyLimits:
    """ASGI middleware that limits bodies.

    Reading more than the size limit raises 413 `too-large`, and a body that arrives too slowly raises 408 `too-slow`.
    Both close the connection.
    """

    def __init__(
        self,
        app: ASGIApp,
        request_bytes: int,
        upload_bytes: int,
        upload_path: str,
        timeouts: BodyTimeouts | None = None,
    ) -> None:
        self._app = app
        self._request_bytes = request_bytes
        self._upload_bytes = upload_bytes
        self._upload_path = upload_path
        self._timeouts = timeouts or BodyTimeouts()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with a `receive` that enforces the limits."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        upload = scope["path"] == self._upload_path
        limit = self._upload_bytes if upload else self._request_bytes
        declared = Headers(scope=scope).get("content-length", "")
        body = _Body(receive, send, limit, upload, self._timeouts)
        body.too_large = declared.isdecimal() and int(declared) > limit
        await self._app(scope, body.receive, body.send)


class _Body:
    """The body of one request as it arrives."""

    def __init__(self, receive: Receive, send: Send, limit: int, upload: bool, timeouts: BodyTimeouts) -> None:
        self._receive, self._send = receive, send
        self._limit, self._upload, self._timeouts = limit, upload, timeouts
        self._received, self._waited_s, self._complete, self._answered = 0, 0.0, False, False
        self.too_large = False

    async def send(self, message: Message) -> None:
        """Send a message. After the first one, no problem can be reported any more."""
        self._answered = True
        await self._send(message)

    async def receive(self) -> Message:
        """Return the next message. If the answer has begun, a bad body counts as a disconnected client.

        Raises:
            ProblemError: The body is too large or too slow, and the answer has not begun.
        """
        if self._complete:  # the next message is the end of the connection, which has no timeout
            return await self._receive()
        try:
            return await self._next()
        except ProblemError:
            if self._answered:
                return {"type": "http.disconnect"}
            raise

    async def _next(self) -> Message:
        if self.too_large:
            raise _too_large(self._limit)
        message = await self._receive_in_time()
        self._received += len(message.get("body", b""))
        self._complete = not message.get("more_body", False)
        self.too_large = self._received > self._limit
        if self.too_large:
            raise _too_large(self._limit)
        return message

    async def _receive_in_time(self) -> Message:
        timeouts, loop = self._timeouts, asyncio.get_running_loop()
        if self._upload:
            # the time that the received bytes take at the minimum rate, and the grace
            total_s = timeouts.upload_grace_s + self._received / timeouts.upload_min_bytes_per_s
        else:
            total_s = timeouts.request_s
        begin = loop.time()
        try:
            async with asyncio.timeout(max(min(timeouts.chunk_s, total_s - self._waited_s), 0.0)):
                return await self._receive()
        except TimeoutError:
            raise _too_slow() from None
        finally:
            self._waited_s += loop.time() - begin


# The rest of the body is not read, so the connection cannot be used for another request.
_CLOSE = {"Connection": "close"}


def _too_large(limit: int) -> ProblemError:
    return ProblemError("too-large", f"the body is larger than {limit} bytes", _CLOSE, max_bytes=limit)


def _too_slow() -> ProblemError:
    return ProblemError("too-slow", "the body arrives too slowly", _CLOSE)
