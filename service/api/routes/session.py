"""Signing in by a browser: the token is given once, and then is in a cookie."""

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field

from service.api.problem_responses import problem_responses
from service.api.schemas.base import Described
from service.security.auth.authentication import Callers
from service.security.auth.caller import Caller, Role
from service.security.auth.session_cookie import session_cookie

router = APIRouter(prefix="/api/session", tags=["session"])

COOKIE = {200: {"headers": {"Set-Cookie": {"schema": {"type": "string"}}}}}


class CallerResource(Described):
    """Who is signed in."""

    name: str
    """The token's; `local` on the service's own machine while there is no token."""
    role: Role
    local: bool
    """Nobody had to say who he is."""


class SessionResource(Described):
    """Who the service takes this browser for."""

    caller: CallerResource | None
    """Null: nobody is signed in, and a token is needed."""


class SignIn(Described):
    """What signs in."""

    model_config = ConfigDict(extra="forbid")

    token: Annotated[str, Field(max_length=200, json_schema_extra={"writeOnly": True})]
    """A token of `pointchain token add`."""


@router.get("", responses=problem_responses())
async def get_session(request: Request) -> SessionResource:
    """Who is signed in. Answers everybody, so that a page can tell whether to ask for a token."""
    known = _callers(request).known_or_none(request.scope)
    return _told(None if known is None else known.caller)


@router.post("", responses=COOKIE | problem_responses("unauthorized", "invalid-request"))
async def sign_in(request: Request, wanted: SignIn, response: Response) -> SessionResource:
    """Keeps the token in a cookie that no script can read, for this address alone."""
    token = wanted.token.strip()
    caller = _callers(request).with_token(token)
    request.state.caller = caller  # for the audit log
    response.headers["Set-Cookie"] = session_cookie(request.scope, token)
    return _told(caller)


@router.delete("", responses=COOKIE | problem_responses())
async def sign_out(request: Request, response: Response) -> SessionResource:
    """Removes the cookie from the browser. The token stays good: `pointchain token remove` ends it."""
    response.headers["Set-Cookie"] = session_cookie(request.scope, None)
    return _told(None)


def _callers(request: Request) -> Callers:
    return request.app.state.callers


def _told(caller: Caller | None) -> SessionResource:
    if caller is None:
        return SessionResource(caller=None)
    return SessionResource(caller=CallerResource(name=caller.name, role=caller.role, local=caller.local))
