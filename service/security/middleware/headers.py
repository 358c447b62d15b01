"""Headers of every answer: what a browser may do with it."""

import re
from pathlib import Path

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.security.auth.roles import DOCS, MANUAL

CONTENT_POLICY = "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
DOCS_POLICY = f"{CONTENT_POLICY}; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
"""Swagger UI sets styles, and its style sheet has pictures in it."""
MANUAL_FOLDER = Path(__file__).parents[2] / "manual"
SCRIPT_HASHES = MANUAL_FOLDER / "script-hashes.txt"
"""One hash a line, of each script inside the manual's pages; `docs/conf.py` writes it."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
UNEXPECTED = HEADERS | {
    "Content-Security-Policy": CONTENT_POLICY,
    "Cache-Control": "no-store",
    "Connection": "close",  # uvicorn does close it, and whoever is not told so loses his next request by that
}
"""Of the answer to an unexpected error, which Starlette sends past all middleware."""


def manual_policy(hashes: Path = SCRIPT_HASHES) -> str:
    """Return the content policy of the manual's pages, which allows the scripts inside them by their hashes.

    Without the file of hashes no such script is allowed. The pages can be read all the same.
    """
    text = hashes.read_text() if hashes.is_file() else ""
    allowed = "".join(f" '{value}'" for value in re.findall(r"^sha256-[A-Za-z0-9+/]{43}=$", text, re.MULTILINE))
    return f"{DOCS_POLICY}; script-src 'self'{allowed}"


def _raw(name: str, value: str) -> tuple[bytes, bytes]:
    return name.lower().encode(), value.encode()


_ALWAYS = [_raw(*item) for item in HEADERS.items()]
_POLICY, _POLICY_OF_DOCS = _raw("Content-Security-Policy", CONTENT_POLICY), _raw("Content-Security-Policy", DOCS_POLICY)
_NO_STORE, _NO_CACHE = _raw("Cache-Control", "no-store"), _raw("Cache-Control", "no-cache")


class SecurityHeaders:
    """ASGI middleware. No answer is kept by a cache, but those with an ETag, which it must ask for again."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._policy_of_manual = _raw("Content-Security-Policy", manual_policy())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, with a `send` that adds the headers."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        policy = self._policy(scope["path"])

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = list(message.get("headers", ()))
                names = {name.lower() for name, _ in given}
                added = [*_ALWAYS, policy]
                if b"cache-control" not in names:
                    added.append(_NO_CACHE if b"etag" in names else _NO_STORE)
                message = {**message, "headers": given + added}
            await send(message)

        await self._app(scope, receive, with_headers)

    def _policy(self, path: str) -> tuple[bytes, bytes]:
        if path == DOCS:
            return _POLICY_OF_DOCS
        return self._policy_of_manual if path.startswith(f"{MANUAL}/") else _POLICY
