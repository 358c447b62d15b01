"""Each request is looked at here before anything of its body is read: the form of its address and headers, by which
name it calls the service, who asks, from which page, and whether he may."""

from functools import partial
from urllib.parse import parse_qsl, unquote

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.problems import ProblemError
from service.security.caller import LOCAL, Caller, Role
from service.security.credential import token_of, unauthorized
from service.security.hosts import AllowedHosts, is_loopback
from service.security.origin import check_origin
from service.security.refusal import refuse
from service.security.roles import Call, OtherMethods, find_call
from service.security.tokens import PREFIX, TokenFile

TARGET_BYTES = 2048
HEADERS_BYTES = 16 * 2**10
SECRETS = frozenset(
    {"token", "access_token", "accesstoken", "auth", "auth_token", "authorization", "bearer", "api_key", "apikey",
     "api-key", "key", "secret", "password"}
)  # fmt: skip
"""Names by which people put a token into an address."""


class Gate:
    """ASGI middleware: lets a request pass, with its caller in the scope's state, or answers it by a refusal."""

    def __init__(self, app: ASGIApp, tokens: TokenFile, hosts: AllowedHosts, local: bool) -> None:
        """`local`: the service listens on loopback alone, where nobody has to say who he is while there is no token."""
        self._app, self._tokens, self._hosts, self._local = app, tokens, hosts, local

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
        token, near = token_of(scope), _from_loopback(scope)
        state["caller"] = caller = self._caller(token, near)
        check_origin(scope)
        if found is None:
            raise ProblemError(404, "not-found", "there is nothing at this address; /docs lists what there is")
        if isinstance(found, OtherMethods):
            allowed = {"Allow": ", ".join(found.methods)}
            raise ProblemError(405, "method-not-allowed", f"{scope['method']} is not possible here", allowed)
        if found.least is not None:
            if not caller.may(found.least):
                raise ProblemError(
                    403, "forbidden", f"this needs a token of the role {found.least}; {caller.name} is {caller.role}"
                )
            state["still_allowed"] = partial(self._still_allowed, token, near, found.least)
        check_encoding(Headers(scope=scope))

    def _still_allowed(self, token: str | None, near: bool, least: Role) -> bool:
        """Whether the same request would pass now."""
        try:
            return self._caller(token, near).may(least)
        except ProblemError:
            return False

    def _caller(self, token: str | None, near: bool) -> Caller:
        """`near`: from this machine. Raises ProblemError: 401 `unauthorized`."""
        if token is not None:
            known = self._tokens.find(token)
            if known is None:
                raise unauthorized("there is no such token, or it was removed: `pointchain token list` has all")
            return Caller(known.name, known.role)
        if self._local and self._tokens.none and near:
            return LOCAL
        raise unauthorized("this needs a token: `pointchain token add` makes one; send it as Authorization: Bearer")


def check_size(scope: Scope) -> None:
    """Raises ProblemError: 414 `target-too-long`, 431 `headers-too-large`."""
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > TARGET_BYTES:
        raise ProblemError(414, "target-too-long", f"the address has more than {TARGET_BYTES} bytes")
    if sum(len(name) + len(value) + 4 for name, value in scope["headers"]) > HEADERS_BYTES:
        raise ProblemError(431, "headers-too-large", f"the headers have more than {HEADERS_BYTES} bytes")


def check_encoding(headers: Headers) -> None:
    """Raises ProblemError: 415 `encoded-body`, which would be taken for what it is not."""
    encoding = headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        raise ProblemError(415, "encoded-body", f"the body's Content-Encoding is {encoding[:80]}: send it as it is")
    if headers.get("content-type", "").lower().startswith("multipart/"):
        raise ProblemError(
            415, "encoded-body", "the body is a form of several parts: send the JSON or the file itself, as it is"
        )


def check_query(scope: Scope) -> None:
    """No token in an address, also no valid one: it would be in logs, histories and bookmarks from then on.

    Raises:
        ProblemError: 400 `token-in-query`.
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
        400,
        "token-in-query",
        "a token must not be in an address, where logs keep it: send it as Authorization: Bearer; if it was a real "
        "one, remove it and make another",
    )


def _has_secret(query: str) -> bool:
    if PREFIX in unquote(query):
        return True
    return any(name.strip().lower() in SECRETS for name, _ in parse_qsl(query, keep_blank_values=True))


def _from_loopback(scope: Scope) -> bool:
    client = scope.get("client")
    return client is not None and is_loopback(client[0])
