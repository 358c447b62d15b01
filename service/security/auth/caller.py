"""The caller of a request. The token identifies the caller before any of the request's body is read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from starlette.requests import HTTPConnection
from starlette.types import Scope

Role = Literal["viewer", "operator", "maintainer"]
ROLES: tuple[Role, ...] = ("viewer", "operator", "maintainer")
"""All roles. Each one may do what those before it may do.

A viewer may read and stop the arm, an operator may also scan, and a maintainer may also acknowledge faults and
calibrate.
"""


@dataclass(frozen=True)
class Caller:
    """The name and the role of a caller."""

    name: str
    role: Role

    def has_role(self, min_role: Role) -> bool:
        """Return whether the caller's role is `min_role` or a higher one."""
        return ROLES.index(self.role) >= ROLES.index(min_role)

    @property
    def local(self) -> bool:
        """Whether the caller is on this machine and needs no token, because there is none."""
        return self is LOCAL

    @property
    def token_name(self) -> str | None:
        """Name of the caller's token, or None if the caller needs no token."""
        return None if self.local else self.name


LOCAL = Caller("local", "maintainer")
"""Every client on this machine while there is no token. No token may have this name."""


def caller_of(request: HTTPConnection) -> Caller:
    """Return the caller of a request to a route that is not public.

    Raises:
        LookupError: The route is public, so its callers are not identified.
    """
    caller = known_caller(request.scope)
    if caller is None:
        raise LookupError(f"{request.scope['path']} is public, so its callers are not identified")
    return caller


def known_caller(scope: Scope) -> Caller | None:
    """Return the caller of a request, or None if the route is public or the request was refused."""
    return scope.get("state", {}).get("caller")


def is_anonymous(state: Mapping[str, Any]) -> bool:
    """Return whether a request with this state was checked and has no caller.

    Such a request is for a public route, or is being refused.
    """
    return "call" in state and "caller" not in state


def still_allowed(request: HTTPConnection) -> Callable[[], bool]:
    """Return a function that checks whether the caller would be let in again.

    A long answer, such as an event stream, calls it repeatedly in the event loop's thread. The route must not be
    public.
    """
    return request.scope["state"]["still_allowed"]
