"""Middleware that answers HEAD at each address that has a GET, with the headers of that answer (RFC 9110)."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class HeadRequests:
    """ASGI middleware that passes a HEAD request on as a GET, and drops the body of the answer.

    An event stream ends at once: it sees a client that has left.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
                await send({"type": "http.response.body", "body": b""})

        scope["method"] = "GET"  # in this scope, because the access log reads its route later
        try:
            await self._app(scope, receive, send_head)
        finally:
            scope["method"] = "HEAD"
