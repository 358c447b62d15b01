"""Routes of browser sessions. A person enters a token or a code once, and the browser keeps a cookie."""

from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import Discriminator, Field, Tag

from service.api.problem_responses import problem_responses
from service.api.schemas.base import ApiModel, RequestModel
from service.security.auth.authentication import Authenticator
from service.security.auth.caller import Caller, Role
from service.security.auth.code_sign_in import CodeSignIn
from service.security.auth.session_cookie import session_cookie

router = APIRouter(prefix="/api/session", tags=["session"])

COOKIE = {200: {"headers": {"Set-Cookie": {"schema": {"type": "string"}}}}}


class CallerResource(ApiModel):
    """The caller that is signed in."""

    name: str
    """Name of the token; `local` on the machine of the service while no token exists."""
    role: Role
    local: bool
    """Whether the caller needs no token."""


class SessionResource(ApiModel):
    """The session of this browser."""

    caller: CallerResource | None
    """Null if no caller is signed in and a token is needed."""


class TokenSignInRequest(RequestModel):
    """Body of a request to sign in with a token."""

    token: Annotated[str, Field(max_length=200, json_schema_extra={"writeOnly": True})]
    """A token from `pointchain token add`."""


class CodeSignInRequest(RequestModel):
    """Body of a request to sign in with a code."""

    code: Annotated[str, Field(max_length=100, json_schema_extra={"writeOnly": True})]
    """A code from `pointchain token code`. Lower case, spaces and dashes are accepted."""


def _only_member(body: Any) -> str | None:
    """Return the member of a body that has either a token or a code, else None."""
    members = {"token", "code"} & set(body) if isinstance(body, dict) else set()
    return members.pop() if len(members) == 1 else None


SignInRequest = Annotated[
    Annotated[TokenSignInRequest, Tag("token")] | Annotated[CodeSignInRequest, Tag("code")],
    Discriminator(
        _only_member,
        custom_error_type="sign_in_members",
        custom_error_message="either token or code is needed, and not both",
    ),
]


@router.get("", responses=problem_responses())
async def get_session(request: Request) -> SessionResource:
    """Return the caller that is signed in. No token is needed, so a page can find out whether to ask for one."""
    credential = _authenticator(request).identify_or_none(request.scope)
    return _response(None if credential is None else credential.caller)


@router.post("", responses=COOKIE | problem_responses("unauthorized", "invalid-request", "too-many-wrong-codes"))
async def sign_in(request: Request, body: SignInRequest, response: Response) -> SessionResource:
    """Sign in with a token or with a code, which is valid once.

    The answer sets a cookie, which scripts cannot read and the browser sends to this address only. An earlier session
    of this browser ends. After too many wrong codes within a minute, further codes are refused for a while; tokens are
    not.
    """
    earlier = _authenticator(request).session_of(request.scope)
    if isinstance(body, TokenSignInRequest):
        secret = body.token.strip()
        caller = _authenticator(request).caller_of_token(secret)
    else:
        request.state.audit_note = "with a code"
        session = await _code_sign_in(request).sign_in(body.code)
        secret, caller = session.secret, Caller(session.token.name, session.token.role)
    request.state.caller = caller  # for the audit log
    if earlier is not None:
        await _code_sign_in(request).sign_out(earlier)
    response.headers["Set-Cookie"] = session_cookie(request.scope, secret)
    return _response(caller)


@router.delete("", responses=COOKIE | problem_responses())
async def sign_out(request: Request, response: Response) -> SessionResource:
    """Remove the cookie from the browser. A session made with a code ends.

    A token stays valid until `pointchain token remove`.
    """
    if (session := _authenticator(request).session_of(request.scope)) is not None:
        await _code_sign_in(request).sign_out(session)
    response.headers["Set-Cookie"] = session_cookie(request.scope, None)
    return _response(None)


def _authenticator(request: Request) -> Authenticator:
    return request.app.state.authenticator


def _code_sign_in(request: Request) -> CodeSignIn:
    return request.app.state.code_sign_in


def _response(caller: Caller | None) -> SessionResource:
    if caller is None:
        return SessionResource(caller=None)
    return SessionResource(caller=CallerResource(name=caller.name, role=caller.role, local=caller.local))
