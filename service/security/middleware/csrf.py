"""No page of another origin makes a browser do anything here.

CORS is off, so no such page can read an answer, nor send a header of its own choice; what is left are the plain
requests that every page may send. A browser says of them where they come from, and the cookie of who is signed in goes
along with those of pages that are of the same host but of another port.
"""

from urllib.parse import urlsplit

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.credential import header

SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""
OWN_HEADERS = (b"x-pointchain", b"authorization")
"""A page of another origin cannot send these without having asked, and it is never answered yes."""
_PORTS = {"http": ":80", "https": ":443"}


def check_origin(scope: Scope, by_cookie: bool = False) -> None:
    """`by_cookie`: a cookie says who asks, which a browser sends by itself.

    Raises:
        ProblemError: `cross-origin`.
    """
    site = b"".join(header(scope, b"sec-fetch-site"))
    ours = site == b"same-origin" or any(header(scope, name) for name in OWN_HEADERS)
    if scope["method"] in SAFE:
        # Following a link is all right. Loading from another page is not: the answer would be hidden from it, but it
        # would take event streams away from others.
        if site in (b"cross-site", b"same-site") and header(scope, b"sec-fetch-mode") != [b"navigate"]:
            raise _refusal("a page of another origin may not load this")
        # Over plain HTTP, away from loopback, browsers do not say where a request comes from.
        if by_cookie and not ours and scope["path"].endswith("/events"):
            raise _refusal("with the cookie, this needs the header X-Pointchain, with any value")
        return
    if site in (b"cross-site", b"same-site"):
        raise _refusal("a page of another origin may not do this")
    origin = header(scope, b"origin")
    if not origin and not by_cookie:
        return  # no browser, or one that says the same by Sec-Fetch-Site
    if origin and (len(origin) > 1 or not _same_authority(origin[0].decode("latin-1"), scope)):
        raise _refusal("a page of another origin may not do this: the header Origin must name the same as Host")
    if not ours:
        raise _refusal("from a browser, this needs the header X-Pointchain, with any value")


def _same_authority(origin: str, scope: Scope) -> bool:
    """Whether the origin's host and port are what the request calls the service by; "null" never is."""
    try:
        scheme, authority, *rest = urlsplit(origin)
    except ValueError:
        return False
    default = _PORTS.get(scheme)
    if default is None or any(rest) or not authority:
        return False
    (host,) = header(scope, b"host")
    return authority.lower().removesuffix(default) == host.decode("latin-1").lower().removesuffix(default)


def _refusal(detail: str) -> ProblemError:
    return ProblemError("cross-origin", detail)
