"""By which names the service may be called.

Also on loopback: a page from elsewhere can have its own name point to 127.0.0.1, and its scripts would then speak to
the service as to their own (DNS rebinding). The browser sends that name as Host.
"""

import ipaddress
import re
from collections.abc import Sequence
from functools import lru_cache

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.credential import header

ANY_ADDRESS = ("0.0.0.0", "::", "")
"""Listened on, not called by."""
_HOST = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9._-]+))(?::[0-9]{1,5})?", re.ASCII)


@lru_cache(maxsize=64)  # the same few are asked for at each request
def is_loopback(host: str) -> bool:
    """Whether a name or address means this machine to itself alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def called_by(listening: str) -> str:
    """The name or address by which whoever is on this machine calls a service that listens there."""
    if listening in ANY_ADDRESS:
        return "::1" if ":" in listening else "127.0.0.1"
    return listening


class AllowedHosts:
    """Loopback's names, the address listened on, and those of the configuration; any port."""

    def __init__(self, listening: str, more: Sequence[str]) -> None:
        own = () if listening in ANY_ADDRESS else (listening,)
        self._names = frozenset(_same(name.strip("[]")) for name in (*own, *more))

    def __contains__(self, host: str) -> bool:
        """`host` as in the header, with or without a port."""
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = _same(found["v6"] or found["name"])
        return name in self._names or is_loopback(name)

    def check(self, scope: Scope) -> None:
        """Raises ProblemError: `host-not-allowed`, or `bad-request` without a host."""
        given = header(scope, b"host")
        if len(given) != 1:
            raise ProblemError("bad-request", "a request needs one header Host")
        if given[0].decode("latin-1") not in self:
            raise ProblemError(
                "host-not-allowed",
                "the service may not be called by this name or address: add it to security.allowed_hosts of the "
                "service's configuration",
            )


@lru_cache(maxsize=64)
def _same(name: str) -> str:
    """One spelling for each name and address."""
    try:
        return ipaddress.ip_address(name).compressed
    except ValueError:
        return name.lower().removesuffix(".")
