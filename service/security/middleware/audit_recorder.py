"""Each request that changes something, and each that was refused, is in the audit log before its answer goes out."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.security.audit.log import AuditLog
from service.security.auth.caller import known_caller
from service.security.auth.roles import STOPS
from service.security.middleware.csrf import SAFE
from service.security.middleware.request_line import header_of, scan_in, scan_of, shown_path

REFUSALS = frozenset(
    {"unauthorized", "forbidden", "host-not-allowed", "cross-origin", "token-in-query", "target-too-long",
     "headers-too-large", "too-many-streams", "not-found", "method-not-allowed"}
)  # fmt: skip
"""Problems by which a request came to nothing at all: of many alike, the first and the number are kept."""
NOT_WORTH_IT = frozenset({"not-found", "method-not-allowed"})
"""Of requests that would have changed nothing anyway."""


class Recorder:
    """ASGI middleware. A stop or cancel does not wait for its entry."""

    def __init__(self, app: ASGIApp, audit: AuditLog) -> None:
        self._app, self._audit = app, audit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, with a `send` that writes first."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answered = False

        async def recorded(message: Message) -> None:
            nonlocal answered
            if not answered and message["type"] == "http.response.start":
                answered = True
                await self._record(scope, message)
            await send(message)

        try:
            await self._app(scope, receive, recorded)
        except Exception:  # raised on; the answer is made outside of all middleware
            if not answered and scope["method"] not in SAFE:
                await self._record(scope, {"status": 500}, "internal")
            raise
        except asyncio.CancelledError:  # the service ends
            if not answered and scope["method"] not in SAFE:
                who, role = _who(scope)
                self._audit.note(who, _what(scope), role=role, scan=scan_in(scope["path"]), result="interrupted")
            raise

    async def _record(self, scope: Scope, answer: Message, slug: str | None = None) -> None:
        state = scope.get("state", {})
        slug = slug or state.get("problem")
        refused = slug in REFUSALS
        if scope["method"] in SAFE and (not refused or slug in NOT_WORTH_IT):
            return
        who, role = _who(scope)
        what = _what(scope)
        call = state.get("call")
        if refused:
            await self._audit.refused(who, role, what, call or scope["method"], answer["status"], slug)
        else:
            result = slug or ("replayed" if header_of(answer, b"idempotency-replayed") == "true" else None)
            scan = scan_of(scope, answer)
            await self._audit.record(who, role, what, scan, answer["status"], result, call not in STOPS)


def _who(scope: Scope) -> tuple[str, str]:
    caller = known_caller(scope)
    if caller is not None:
        return caller.name, caller.role
    client = scope.get("client")
    return (client[0] if client else "unknown"), "none"


def _what(scope: Scope) -> str:
    return f"{scope['method'][:10]} {shown_path(scope['path'])}"
