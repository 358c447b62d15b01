"""Protection against requests that a page of another origin makes a browser send (CSRF).

CORS is off, so such a page can neither read an answer nor send a header of its own choice. It can still send the simple
requests that are allowed to every page. The browser names their origin. If the page has the same host and another port,
the browser also sends the cookie of the person who is signed in.
"""

from urllib.parse import urlsplit

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.credential import header_values

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing."""
PREFLIGHTED_HEADERS = (b"x-pointchain", b"authorization")
"""Headers that a page of another origin can send only after a preflight request, which is always refused."""
_PORTS = {"http": ":80", "https": ":443"}


def check_origin(scope: Scope, by_cookie: bool = False) -> None:
    """Check that a request does not come from a page of another origin.

    Args:
        scope: Scope of the request.
        by_cookie: Whether a cookie identified the caller, which a browser sends by itself.

    Raises:
        ProblemError: The request comes from another origin, or does not prove its origin (`cross-origin`).
    """
    site = b"".join(header_values(scope, b"sec-fetch-site"))
    same_origin = site == b"same-origin" or any(header_values(scope, name) for name in PREFLIGHTED_HEADERS)
    if scope["method"] in SAFE_METHODS:
        # A link may be followed. Another page may not load anything: it could not read the answer, but it would use up
        # the event streams.
        if site in (b"cross-site", b"same-site") and header_values(scope, b"sec-fetch-mode") != [b"navigate"]:
            raise ProblemError("cross-origin", "a page of another origin may not load this")
        # Over plain HTTP, except on loopback, browsers do not send Sec-Fetch-Site.
        if by_cookie and not same_origin and scope["path"].endswith("/events"):
            raise ProblemError("cross-origin", "with the cookie, this needs the header X-Pointchain, with any value")
        return
    if site in (b"cross-site", b"same-site"):
        raise ProblemError("cross-origin", "a page of another origin may not do this")
    origin = header_values(scope, b"origin")
    if not origin and not by_cookie:
        return  # not a browser, or one that reports the same in Sec-Fetch-Site
    if origin and (len(origin) > 1 or not _is_same_authority(origin[0].decode("latin-1"), scope)):
        raise ProblemError(
            "cross-origin", "a page of another origin may not do this: the headers Origin and Host must match"
        )
    if not same_origin:
        raise ProblemError("cross-origin", "from a browser, this needs the header X-Pointchain, with any value")


def _is_same_authority(origin: str, scope: Scope) -> bool:
    """Return whether host and port of the origin are those in the header Host. The origin "null" never matches."""
    try:
        scheme, authority, *rest = urlsplit(origin)
    except ValueError:
        return False
    default = _PORTS.get(scheme)
    if default is None or any(rest) or not authority:
        return False
    (host,) = header_values(scope, b"host")
    return authority.lower().removesuffix(default) == host.decode("latin-1").lower().removesuffix(default)
