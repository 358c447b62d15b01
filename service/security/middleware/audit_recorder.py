"""Middleware that writes each request that changes something, and each refused one, to the audit log."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.security.audit.log import AuditLog
from service.security.auth.caller import known_caller
from service.security.auth.roles import STOP_CALLS
from service.security.middleware.csrf import SAFE_METHODS
from service.security.middleware.request_line import (
    printable_path,
    response_header,
    scan_id_in_path,
    scan_id_of_request,
)

REFUSALS = frozenset(
    {"unauthorized", "forbidden", "host-not-allowed", "cross-origin", "token-in-query", "target-too-long",
     "headers-too-large", "too-many-streams", "too-many-wrong-codes", "not-found", "method-not-allowed"}
)  # fmt: skip
"""Problems of refused requests. Repeated refusals are counted and written as one entry."""
IGNORED_IF_SAFE = frozenset({"not-found", "method-not-allowed"})
"""Refusals that are not written if the request could not have changed anything."""


class AuditMiddleware:
    """ASGI middleware that writes the entry of a request before its answer. A stop or cancel does not wait for it."""

    def __init__(self, app: ASGIApp, audit: AuditLog) -> None:
        self._app, self._audit = app, audit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with a `send` that writes the entry before the answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answered = False

        async def recording_send(message: Message) -> None:
            nonlocal answered
            if not answered and message["type"] == "http.response.start":
                answered = True
                await self._record(scope, message)
            await send(message)

        try:
            await self._app(scope, receive, recording_send)
        except Exception:  # the answer is made outside of all middleware
            if not answered and scope["method"] not in SAFE_METHODS:
                await self._record(scope, {"status": 500}, "internal")
            raise
        except asyncio.CancelledError:  # the service ends
            if not answered and scope["method"] not in SAFE_METHODS:
                who, role = _caller_name_and_role(scope)
                scan = scan_id_in_path(scope["path"])
                self._audit.add(who, _request_line(scope), role=role, scan=scan, result="interrupted")
            raise

    async def _record(self, scope: Scope, answer: Message, slug: str | None = None) -> None:
        state = scope.get("state", {})
        slug = slug or state.get("problem")
        refused = slug in REFUSALS
        if scope["method"] in SAFE_METHODS and (not refused or slug in IGNORED_IF_SAFE):
            return
        who, role = _caller_name_and_role(scope)
        what = _request_line(scope)
        call = state.get("call")
        if refused:
            await self._audit.record_refusal(who, role, what, call or scope["method"], answer["status"], slug)
        else:
            replayed = response_header(answer, b"idempotency-replayed") == "true"
            result = slug or ("replayed" if replayed else None)
            scan = scan_id_of_request(scope, answer)
            await self._audit.record(who, role, what, scan, answer["status"], result, call not in STOP_CALLS)


def _caller_name_and_role(scope: Scope) -> tuple[str, str]:
    caller = known_caller(scope)
    if caller is not None:
        return caller.name, caller.role
    client = scope.get("client")
    return (client[0] if client else "unknown"), "none"


def _request_line(scope: Scope) -> str:
    note = scope.get("state", {}).get("audit_note")
    line = f"{scope['method'][:10]} {printable_path(scope['path'])}"
    return line if note is None else f"{line} ({note})"
