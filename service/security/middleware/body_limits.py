"""How much of a body is read, and how long it may take to come: counted as it comes in, for a declared length may be
missing or a lie."""

import asyncio
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems.problem_error import ProblemError


@dataclass(frozen=True)
class Patience:
    """How long a sender is waited for, seconds. Only the waiting counts, not what is done with what has come."""

    chunk_s: float = 10.0
    """For the next part of a body."""
    request_s: float = 15.0
    """For the whole body, but of an upload."""
    upload_grace_s: float = 15.0
    """After so long, an upload ..."""
    upload_bytes_per_s: float = 10_000.0
    """... must have come as fast as this on average."""


class BodyLimits:
    """ASGI middleware: reading more than the limit of a body is a problem 413 `too-large`, one that comes too slowly
    408 `too-slow`; both end the connection."""

    def __init__(
        self,
        app: ASGIApp,
        request_bytes: int,
        upload_bytes: int,
        upload_path: str,
        patience: Patience | None = None,
    ) -> None:
        self._app = app
        self._request_bytes = request_bytes
        self._upload_bytes = upload_bytes
        self._upload_path = upload_path
        self._patience = patience or Patience()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, with a `receive` that counts."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        upload = scope["path"] == self._upload_path
        limit = self._upload_bytes if upload else self._request_bytes
        declared = Headers(scope=scope).get("content-length", "")
        body = _Body(receive, send, limit, upload, self._patience)
        body.too_large = declared.isdecimal() and int(declared) > limit
        await self._app(scope, body.receive, body.send)


class _Body:
    """One request's body as it comes in."""

    def __init__(self, receive: Receive, send: Send, limit: int, upload: bool, patience: Patience) -> None:
        self._receive, self._send = receive, send
        self._limit, self._upload, self._patience = limit, upload, patience
        self._received, self._waited_s, self._whole, self._answered = 0, 0.0, False, False
        self.too_large = False

    async def send(self, message: Message) -> None:
        """Sends on; behind the first message no refusal can be told any more."""
        self._answered = True
        await self._send(message)

    async def receive(self) -> Message:
        """The next message. Raises ProblemError; once the answer is under way, the sender counts as gone instead."""
        if self._whole:  # what comes now is the end of the connection, which may be waited for as long as one likes
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
        message = await self._in_time()
        self._received += len(message.get("body", b""))
        self._whole = not message.get("more_body", False)
        self.too_large = self._received > self._limit
        if self.too_large:
            raise _too_large(self._limit)
        return message

    async def _in_time(self) -> Message:
        patience, loop = self._patience, asyncio.get_running_loop()
        if self._upload:
            # As long as what has come would have taken at the least speed, and the grace.
            whole_s = patience.upload_grace_s + self._received / patience.upload_bytes_per_s
        else:
            whole_s = patience.request_s
        begin = loop.time()
        try:
            async with asyncio.timeout(max(min(patience.chunk_s, whole_s - self._waited_s), 0.0)):
                return await self._receive()
        except TimeoutError:
            raise _too_slow() from None
        finally:
            self._waited_s += loop.time() - begin


# The rest of the body is not read, so the connection cannot serve another request.
_CLOSE = {"Connection": "close"}


def _too_large(limit: int) -> ProblemError:
    return ProblemError("too-large", f"the body is larger than {limit} bytes", _CLOSE)


def _too_slow() -> ProblemError:
    return ProblemError("too-slow", "the body comes too slowly", _CLOSE)
