"""No request body larger than allowed, counted as it comes in: a declared length may be missing or a lie."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems import ProblemError


class BodyLimit:
    """ASGI middleware: reading more than the limit of a body is a problem `too-large`, status 413."""

    def __init__(self, app: ASGIApp, request_bytes: int, upload_bytes: int, upload_path: str) -> None:
        self._app = app
        self._request_bytes = request_bytes
        self._upload_bytes = upload_bytes
        self._upload_path = upload_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, with a `receive` that counts."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        limit = self._upload_bytes if scope["path"] == self._upload_path else self._request_bytes
        declared = Headers(scope=scope).get("content-length", "")
        received = 0

        async def counted() -> Message:
            nonlocal received
            if declared.isdecimal() and int(declared) > limit:
                raise _too_large(limit)
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:
                raise _too_large(limit)
            return message

        await self._app(scope, counted, send)


def _too_large(limit: int) -> ProblemError:
    # The rest of the body is not read, so the connection cannot serve another request.
    return ProblemError(413, "too-large", f"the body is larger than {limit} bytes", {"Connection": "close"})
