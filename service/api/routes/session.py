"""Routes of browser sessions. A person enters the token once, and the browser keeps it in a cookie."""

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field

from service.api.problem_responses import problem_responses
from service.api.schemas.base import ApiModel
from service.security.auth.authentication import Authenticator
from service.security.auth.caller import Caller, Role
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


class SignInRequest(ApiModel):
    """Body of a request to sign in."""

    model_config = ConfigDict(extra="forbid")

    token: Annotated[str, Field(max_length=200, json_schema_extra={"writeOnly": True})]
    """A token from `pointchain token add`."""


@router.get("", responses=problem_responses())
async def get_session(request: Request) -> SessionResource:
    """Return the caller that is signed in. No token is needed, so a page can find out whether to ask for one."""
    credential = _authenticator(request).identify_or_none(request.scope)
    return _response(None if credential is None else credential.caller)


@router.post("", responses=COOKIE | problem_responses("unauthorized", "invalid-request"))
async def sign_in(request: Request, body: SignInRequest, response: Response) -> SessionResource:
    """Keep the token in a cookie, which scripts cannot read and the browser sends to this address only."""
    token = body.token.strip()
    caller = _authenticator(request).caller_of_token(token)
    request.state.caller = caller  # for the audit log
    response.headers["Set-Cookie"] = session_cookie(request.scope, token)
    return _response(caller)


@router.delete("", responses=COOKIE | problem_responses())
async def sign_out(request: Request, response: Response) -> SessionResource:
    """Remove the cookie from the browser. The token stays valid until `pointchain token remove`."""
    response.headers["Set-Cookie"] = session_cookie(request.scope, None)
    return _response(None)


def _authenticator(request: Request) -> Authenticator:
    return request.app.state.authenticator


def _response(caller: Caller | None) -> SessionResource:
    if caller is None:
        return SessionResource(caller=None)
    return SessionResource(caller=CallerResource(name=caller.name, role=caller.role, local=caller.local))
