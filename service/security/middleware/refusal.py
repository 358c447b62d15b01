"""A refusal before a request has come to any route: as the same problem document as everywhere."""

from typing import Any
from urllib.parse import quote

from starlette.responses import JSONResponse
from starlette.types import Receive, Scope, Send

from service.problems.document import MEDIA_TYPE, problem_document
from service.problems.problem_error import ProblemError

SMALL_BYTES = 64 * 2**10
"""So much of a body that nobody asked for is read past; behind more of it, the connection is closed."""


async def refuse(scope: Scope, receive: Receive, send: Send, error: ProblemError) -> None:
    """Answers the request with `error`, and reads nothing of its body."""
    state: dict[str, Any] = scope.setdefault("state", {})
    state["problem"] = error.slug
    headers = dict(error.headers or {})
    if _has_large_body(scope):
        headers["Connection"] = "close"
    document = problem_document(error.slug, error.detail, quote(scope["path"]))
    answer = JSONResponse(document, error.status_code, headers=headers, media_type=MEDIA_TYPE)
    await answer(scope, receive, send)


def _has_large_body(scope: Scope) -> bool:
    """Or one of which nobody knows how large it is."""
    for name, value in scope["headers"]:
        if name == b"transfer-encoding":
            return True
        if name == b"content-length":
            return not (value.isdigit() and len(value) < 10 and int(value) <= SMALL_BYTES)
    return False
