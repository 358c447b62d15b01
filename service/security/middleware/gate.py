"""Middleware that checks a request before any of its body is read.

It checks the size of address and headers, the host name, the caller, the origin and the caller's role.
"""

from functools import partial
from urllib.parse import parse_qsl, unquote

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import AllowedHosts
from service.security.auth.authentication import Authenticator
from service.security.auth.caller import Role
from service.security.auth.roles import Call, OtherMethods, find_call
from service.security.auth.sessions import SESSION_PREFIX
from service.security.auth.tokens import PREFIX
from service.security.middleware.csrf import check_origin
from service.security.middleware.refusal import refuse

MAX_TARGET_BYTES = 2048
MAX_HEADERS_BYTES = 16 * 2**10
SECRET_PREFIXES = (PREFIX, SESSION_PREFIX)
SECRET_PARAMETERS = frozenset(
    {"token", "access_token", "accesstoken", "auth", "auth_token", "authorization", "bearer", "api_key", "apikey",
     "api-key", "key", "secret", "password"}
)  # fmt: skip
"""Names of query parameters in which people send tokens."""


class Gate:
    """ASGI middleware that passes a request on, with the caller in the scope's state, or refuses it."""

    def __init__(self, app: ASGIApp, authenticator: Authenticator, hosts: AllowedHosts) -> None:
        self._app, self._authenticator, self._hosts = app, authenticator, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            try:
                self._check(scope)
            except ProblemError as error:
                await refuse(scope, receive, send, error)
            else:
                await self._app(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": 1008})  # the service has no WebSocket

    def _check(self, scope: Scope) -> None:
        """Check a request, and set the call and the caller in its state; raise ProblemError to refuse it."""
        state = scope.setdefault("state", {})
        check_size(scope)
        check_framing(Headers(scope=scope))
        self._hosts.check(scope)
        check_query(scope)
        found = find_call(scope["method"], scope["path"])
        if isinstance(found, Call):
            state["call"] = found.name
            if found.min_role is None:
                check_origin(scope)
                return
        identity = self._authenticator.identify(scope)
        state["caller"] = caller = identity.caller
        check_origin(scope, identity.by_cookie)
        if found is None:
            raise ProblemError("not-found", "there is nothing at this address; /docs lists what there is")
        if isinstance(found, OtherMethods):
            allowed = {"Allow": ", ".join(found.methods)}
            method: str = scope["method"]
            raise ProblemError("method-not-allowed", f"{method} is not possible here", allowed, method=method)
        if found.min_role is not None:
            if not caller.has_role(found.min_role):
                raise ProblemError(
                    "forbidden",
                    f"this needs a token with the role {found.min_role}; {caller.name} has the role {caller.role}",
                    needed_role=found.min_role,
                    role=caller.role,
                )
            state["still_allowed"] = partial(self._still_allowed, scope, found.min_role)
        check_encoding(Headers(scope=scope))

    def _still_allowed(self, scope: Scope, min_role: Role) -> bool:
        """Return whether the same request would pass now."""
        try:
            return self._authenticator.identify(scope).caller.has_role(min_role)
        except ProblemError:
            return False


def check_size(scope: Scope) -> None:
    """Check the size of the address and of the headers.

    Raises:
        ProblemError: The address (`target-too-long`) or the headers (`headers-too-large`) are too large.
    """
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MAX_TARGET_BYTES:
        raise ProblemError(
            "target-too-long", f"the address has more than {MAX_TARGET_BYTES} bytes", max_bytes=MAX_TARGET_BYTES
        )
    if sum(len(name) + len(value) + 4 for name, value in scope["headers"]) > MAX_HEADERS_BYTES:
        raise ProblemError(
            "headers-too-large", f"the headers have more than {MAX_HEADERS_BYTES} bytes", max_bytes=MAX_HEADERS_BYTES
        )


def check_framing(headers: Headers) -> None:
    """Check that a request does not give the length of its body in two ways.

    A proxy may read the other one than this server, and take a part of the body for a further request. The answer
    closes the connection (RFC 9112, section 6.1).

    Raises:
        ProblemError: It gives both (`bad-request`).
    """
    if "content-length" in headers and "transfer-encoding" in headers:
        raise ProblemError(
            "bad-request",
            "the request has Content-Length and Transfer-Encoding: send one of them",
            {"Connection": "close"},
        )


def check_encoding(headers: Headers) -> None:
    """Check that the body is sent without an encoding, because routes would misread an encoded one.

    Raises:
        ProblemError: The body is compressed or a multipart form (`encoded-body`).
    """
    encoding = headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        raise ProblemError("encoded-body", f"the body's Content-Encoding is {encoding[:80]}: send the body as it is")
    if headers.get("content-type", "").lower().startswith("multipart/"):
        raise ProblemError("encoded-body", "the body is a multipart form: send the JSON or the file itself, as it is")


def check_query(scope: Scope) -> None:
    """Check that the address has no token, not even a valid one: logs, histories and bookmarks would keep it.

    Raises:
        ProblemError: The path or the query has a token (`token-in-query`).
    """
    query = scope["query_string"].decode("latin-1")
    in_path = any(prefix in scope["path"] for prefix in SECRET_PREFIXES)
    if not in_path and (not query or not _has_secret(query)):
        return
    # The server's own log reads the address from the scope.
    scope["query_string"] = b""
    if in_path:
        scope["path"], scope["raw_path"] = "/", b"/"
    raise ProblemError(
        "token-in-query",
        "a token must not be in an address, where logs keep it: send it as Authorization: Bearer; if it was valid, "
        "remove it and make another",
    )


def _has_secret(query: str) -> bool:
    if any(prefix in unquote(query) for prefix in SECRET_PREFIXES):
        return True
    return any(name.strip().lower() in SECRET_PARAMETERS for name, _ in parse_qsl(query, keep_blank_values=True))
