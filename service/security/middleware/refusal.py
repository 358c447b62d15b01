"""Answers to refused requests, as problem documents, before the request reaches a route."""

from typing import Any
from urllib.parse import quote

from starlette.responses import JSONResponse
from starlette.types import Receive, Scope, Send

from service.problems.document import MEDIA_TYPE, problem_document
from service.problems.problem_error import ProblemError

MAX_DISCARDED_BYTES = 64 * 2**10
"""Maximum size of an unread body that is discarded to keep the connection. For a larger one, the connection closes."""


async def refuse(scope: Scope, receive: Receive, send: Send, error: ProblemError) -> None:
    """Answer a request with `error`, without reading its body."""
    state: dict[str, Any] = scope.setdefault("state", {})
    state["problem"] = error.slug
    headers = dict(error.headers or {})
    if _has_large_body(scope):
        headers["Connection"] = "close"
    document = problem_document(error.slug, error.detail, quote(scope["path"]), error.parameters)
    answer = JSONResponse(document, error.status_code, headers=headers, media_type=MEDIA_TYPE)
    await answer(scope, receive, send)


def _has_large_body(scope: Scope) -> bool:
    """Return whether the body is larger than `MAX_DISCARDED_BYTES`, or of unknown size."""
    for name, value in scope["headers"]:
        if name == b"transfer-encoding":
            return True
        if name == b"content-length":
            return not (value.isdigit() and len(value) < 10 and int(value) <= MAX_DISCARDED_BYTES)
    return False
