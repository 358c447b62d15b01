"""A stop goes before everything else that is asked for."""

import asyncio
import contextlib

from starlette.types import ASGIApp, Receive, Scope, Send

HOLD_S = 0.2
"""No request waits longer than this for a stop's answer. A real arm takes about as long to come to rest."""


class StopFirst:
    """ASGI middleware: no other request is begun while somebody stops something.

    Each of them takes the one interpreter for a moment; a stop needs it several times on its way to the arm and back,
    and with many clients would wait for all of them each time.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._stopping = 0
        self._over = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, if need be when the stop is answered."""
        if scope["type"] == "http" and _stops(scope):
            await self._stop(scope, receive, send)
            return
        if self._stopping:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._over.wait(), HOLD_S)
        await self._app(scope, receive, send)

    async def _stop(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._stopping == 0:
            self._over.clear()
        self._stopping += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._stopping -= 1
            if self._stopping == 0:
                self._over.set()


def _stops(scope: Scope) -> bool:
    path: str = scope["path"]
    return scope["method"] == "POST" and (path == "/api/cell/stop" or path.endswith("/cancel"))
