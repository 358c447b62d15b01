"""Who asks: known from the token that a request carries, before anything of its body is read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from starlette.requests import HTTPConnection
from starlette.types import Scope

Role = Literal["viewer", "operator", "maintainer"]
ROLES: tuple[Role, ...] = ("viewer", "operator", "maintainer")
"""Each may do what those before it may: look, and stop the arm; scan; acknowledge faults and calibrate."""


@dataclass(frozen=True)
class Caller:
    """Who asks, and what he may do."""

    name: str
    role: Role

    def may(self, least: Role) -> bool:
        """Whether his role is `least` or more."""
        return ROLES.index(self.role) >= ROLES.index(least)

    @property
    def local(self) -> bool:
        """Nobody had to say who he is: there is no token, and he is on this machine."""
        return self is LOCAL


LOCAL = Caller("local", "maintainer")
"""Everybody on this machine, as long as there is no token. No token has its name."""


def caller_of(request: HTTPConnection) -> Caller:
    """Who asks; whatever is not open to everybody has a caller. Raises LookupError where it is."""
    caller = known_caller(request.scope)
    if caller is None:
        raise LookupError(f"{request.scope['path']} is open to everybody: nobody had to say who he is")
    return caller


def known_caller(scope: Scope) -> Caller | None:
    """Who asks; None where everybody may, and where nobody was let in."""
    return scope.get("state", {}).get("caller")


def is_nobodys(state: Mapping[str, Any]) -> bool:
    """The request of this state was looked at, and has no caller: it asks for what is open to everybody, or is being
    refused."""
    return "call" in state and "caller" not in state


def still_allowed(request: HTTPConnection) -> Callable[[], bool]:
    """Whether who asks would be let in again: to be asked time and again where an answer goes on for long, in the event
    loop's thread. Of whatever is not open to everybody."""
    return request.scope["state"]["still_allowed"]
