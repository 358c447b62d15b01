"""Middleware that gives stop requests priority over all other requests."""

import asyncio
import contextlib

from starlette.types import ASGIApp, Receive, Scope, Send

from service.security.auth.roles import STOP_CALLS

MAX_WAIT_S = 0.2
"""Longest time that another request waits for a stop. A real arm takes about as long to come to rest."""


class StopPriority:
    """ASGI middleware that begins no other request while a stop or a cancel is running.

    Each request holds the one interpreter for a moment. A stop needs the interpreter several times on its path to the
    arm and back, and with many clients it would wait for all of them each time.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._stops_running = 0
        self._no_stop_running = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on. If a stop is running, wait for its answer first, at most `MAX_WAIT_S`."""
        if scope["type"] == "http" and _is_stop(scope):
            await self._run_stop(scope, receive, send)
            return
        if self._stops_running:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._no_stop_running.wait(), MAX_WAIT_S)
        await self._app(scope, receive, send)

    async def _run_stop(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._stops_running == 0:
            self._no_stop_running.clear()
        self._stops_running += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._stops_running -= 1
            if self._stops_running == 0:
                self._no_stop_running.set()


def _is_stop(scope: Scope) -> bool:
    """Return whether the request is a stop or a cancel, by the call's name from the security layer around this one."""
    return scope.get("state", {}).get("call") in STOP_CALLS
