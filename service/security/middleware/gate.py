"""Each request is looked at here before anything of its body is read: the form of its address and headers, by which
name it calls the service, who asks, from which page, and whether he may."""

from functools import partial
from urllib.parse import parse_qsl, unquote

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import AllowedHosts
from service.security.auth.authentication import Callers
from service.security.auth.caller import Role
from service.security.auth.roles import Call, OtherMethods, find_call
from service.security.auth.tokens import PREFIX
from service.security.middleware.csrf import check_origin
from service.security.middleware.refusal import refuse

TARGET_BYTES = 2048
HEADERS_BYTES = 16 * 2**10
SECRETS = frozenset(
    {"token", "access_token", "accesstoken", "auth", "auth_token", "authorization", "bearer", "api_key", "apikey",
     "api-key", "key", "secret", "password"}
)  # fmt: skip
"""Names by which people put a token into an address."""


class Gate:
    """ASGI middleware: lets a request pass, with its caller in the scope's state, or answers it by a refusal."""

    def __init__(self, app: ASGIApp, callers: Callers, hosts: AllowedHosts) -> None:
        self._app, self._callers, self._hosts = app, callers, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, or refuses it."""
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
            await send({"type": "websocket.close", "code": 1008})  # there is nothing to speak to in this way

    def _check(self, scope: Scope) -> None:
        """Raises ProblemError: why not."""
        state = scope.setdefault("state", {})
        check_size(scope)
        self._hosts.check(scope)
        check_query(scope)
        found = find_call(scope["method"], scope["path"])
        if isinstance(found, Call):
            state["call"] = found.name
            if found.least is None:
                check_origin(scope)
                return
        known = self._callers.known(scope)
        state["caller"] = caller = known.caller
        check_origin(scope, known.by_cookie)
        if found is None:
            raise ProblemError("not-found", "there is nothing at this address; /docs lists what there is")
        if isinstance(found, OtherMethods):
            allowed = {"Allow": ", ".join(found.methods)}
            raise ProblemError("method-not-allowed", f"{scope['method']} is not possible here", allowed)
        if found.least is not None:
            if not caller.may(found.least):
                raise ProblemError(
                    "forbidden", f"this needs a token of the role {found.least}; {caller.name} is {caller.role}"
                )
            state["still_allowed"] = partial(self._still_allowed, scope, found.least)
        check_encoding(Headers(scope=scope))

    def _still_allowed(self, scope: Scope, least: Role) -> bool:
        """Whether the same request would pass now."""
        try:
            return self._callers.known(scope).caller.may(least)
        except ProblemError:
            return False


def check_size(scope: Scope) -> None:
    """Raises ProblemError: `target-too-long`, `headers-too-large`."""
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > TARGET_BYTES:
        raise ProblemError("target-too-long", f"the address has more than {TARGET_BYTES} bytes")
    if sum(len(name) + len(value) + 4 for name, value in scope["headers"]) > HEADERS_BYTES:
        raise ProblemError("headers-too-large", f"the headers have more than {HEADERS_BYTES} bytes")


def check_encoding(headers: Headers) -> None:
    """Raises ProblemError: `encoded-body`, which would be taken for what it is not."""
    encoding = headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        raise ProblemError("encoded-body", f"the body's Content-Encoding is {encoding[:80]}: send it as it is")
    if headers.get("content-type", "").lower().startswith("multipart/"):
        raise ProblemError(
            "encoded-body", "the body is a form of several parts: send the JSON or the file itself, as it is"
        )


def check_query(scope: Scope) -> None:
    """No token in an address, also no valid one: it would be in logs, histories and bookmarks from then on.

    Raises:
        ProblemError: `token-in-query`.
    """
    query = scope["query_string"].decode("latin-1")
    in_path = PREFIX in scope["path"]
    if not in_path and (not query or not _has_secret(query)):
        return
    # The server's own log takes it from here.
    scope["query_string"] = b""
    if in_path:
        scope["path"], scope["raw_path"] = "/", b"/"
    raise ProblemError(
        "token-in-query",
        "a token must not be in an address, where logs keep it: send it as Authorization: Bearer; if it was a real "
        "one, remove it and make another",
    )


def _has_secret(query: str) -> bool:
    if PREFIX in unquote(query):
        return True
    return any(name.strip().lower() in SECRETS for name, _ in parse_qsl(query, keep_blank_values=True))
