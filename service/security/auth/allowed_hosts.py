"""The host names by which the service may be called.

They are checked on loopback too. A web page of another site can make its own name point to 127.0.0.1, and its scripts
would then have access to the service as to their own site (DNS rebinding). The browser sends that name as Host.
"""

import ipaddress
import re
from collections.abc import Sequence
from functools import lru_cache

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.credential import header_values

ANY_ADDRESS = ("0.0.0.0", "::", "")
"""Addresses to listen on for all interfaces. No client calls the service by them."""
_HOST = re.compile(r"(?:\[(?P<v6>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9._-]+))(?::[0-9]{1,5})?", re.ASCII)


@lru_cache(maxsize=64)  # each request asks for one of a few names
def is_loopback(host: str) -> bool:
    """Return whether a name or address is that of the loopback interface."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def local_address(listen_host: str) -> str:
    """Return the name or address by which a client on this machine reaches a service that listens there."""
    if listen_host in ANY_ADDRESS:
        return "::1" if ":" in listen_host else "127.0.0.1"
    return listen_host


class AllowedHosts:
    """The allowed values of the header Host: the names of loopback, the listen address and the configured names.

    Any port is allowed.
    """

    def __init__(self, listen_host: str, configured: Sequence[str]) -> None:
        own = () if listen_host in ANY_ADDRESS else (listen_host,)
        self._names = frozenset(_normalise(name.strip("[]")) for name in (*own, *configured))

    def __contains__(self, host: str) -> bool:
        """Return whether a value of the header, with or without a port, is allowed."""
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = _normalise(found["v6"] or found["name"])
        return name in self._names or is_loopback(name)

    def check(self, scope: Scope) -> None:
        """Check the header Host of a request.

        Raises:
            ProblemError: The host is not allowed (`host-not-allowed`), or there is not exactly one (`bad-request`).
        """
        hosts = header_values(scope, b"host")
        if len(hosts) != 1:
            raise ProblemError("bad-request", "the request must have exactly one header Host")
        if hosts[0].decode("latin-1") not in self:
            raise ProblemError(
                "host-not-allowed",
                "the service may not be called by this name or address: add it to security.allowed_hosts of the "
                "service's configuration",
            )


@lru_cache(maxsize=64)
def _normalise(name: str) -> str:
    """Return the same spelling for all spellings of a name or address."""
    try:
        return ipaddress.ip_address(name).compressed
    except ValueError:
        return name.lower().removesuffix(".")
