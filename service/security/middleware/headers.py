"""Middleware that adds the security headers to every answer."""

import re
from pathlib import Path

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.security.auth.roles import DOCS, MANUAL

CONTENT_POLICY = "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
DOCS_POLICY = f"{CONTENT_POLICY}; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
"""Content policy of the API's page. Swagger UI sets inline styles, and its style sheet contains images."""
MANUAL_FOLDER = Path(__file__).parents[2] / "manual"
SCRIPT_HASHES = MANUAL_FOLDER / "script-hashes.txt"
"""Hashes of the inline scripts of the manual, one per line. `docs/conf.py` writes the file."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
UNEXPECTED_ERROR_HEADERS = HEADERS | {
    "Content-Security-Policy": CONTENT_POLICY,
    "Cache-Control": "no-store",
    "Connection": "close",  # uvicorn closes it, and a client that does not know this loses its next request
}
"""Headers of the answer to an unexpected error, which Starlette sends past all middleware."""


def manual_policy(hashes: Path = SCRIPT_HASHES) -> str:
    """Return the content policy of the manual's pages, which allows their inline scripts by their hashes.

    Args:
        hashes: File with the hashes. Without it, no inline script is allowed; the pages remain readable.
    """
    text = hashes.read_text() if hashes.is_file() else ""
    allowed = "".join(f" '{value}'" for value in re.findall(r"^sha256-[A-Za-z0-9+/]{43}=$", text, re.MULTILINE))
    return f"{DOCS_POLICY}; script-src 'self'{allowed}"


def _raw(name: str, value: str) -> tuple[bytes, bytes]:
    return name.lower().encode(), value.encode()


_ALWAYS = [_raw(*item) for item in HEADERS.items()]
_POLICY_HEADER = _raw("Content-Security-Policy", CONTENT_POLICY)
_DOCS_POLICY_HEADER = _raw("Content-Security-Policy", DOCS_POLICY)
_NO_STORE, _NO_CACHE = _raw("Cache-Control", "no-store"), _raw("Cache-Control", "no-cache")


class SecurityHeaders:
    """ASGI middleware that adds the headers.

    No answer may be cached, except one with an ETag, which the cache must revalidate before each use.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._manual_policy_header = _raw("Content-Security-Policy", manual_policy())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, with a `send` that adds the headers."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        policy = self._policy(scope["path"])

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = list(message.get("headers", ()))
                names = {name.lower() for name, _ in headers}
                added = [*_ALWAYS, policy]
                if b"cache-control" not in names:
                    added.append(_NO_CACHE if b"etag" in names else _NO_STORE)
                message = {**message, "headers": headers + added}
            await send(message)

        await self._app(scope, receive, send_with_headers)

    def _policy(self, path: str) -> tuple[bytes, bytes]:
        if path == DOCS:
            return _DOCS_POLICY_HEADER
        return self._manual_policy_header if path.startswith(f"{MANUAL}/") else _POLICY_HEADER
