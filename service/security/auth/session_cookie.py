"""The cookie by which a browser says who asks: the token itself, which no script of a page can read.

It is the token and no number of a session, so that it is good and ends with the token, also while the database is held
by another program: somebody who is signed in must be able to stop the arm.
"""

from http.cookies import Morsel
from urllib.parse import urlsplit

from starlette.types import Scope

from service.security.auth.credential import header
from service.security.auth.tokens import PREFIX

LASTS_S = 180 * 24 * 3600
"""Then the token must be given again."""


def cookie_name(scope: Scope) -> str:
    """The cookie's name. Cookies do not tell ports apart, so that two services of one machine need two."""
    (host,) = header(scope, b"host")
    try:
        port = urlsplit(f"//{host.decode('latin-1')}").port
    except ValueError:
        port = None
    return "pointchain" if port is None else f"pointchain_{port}"


def token_in_cookie(scope: Scope) -> str | None:
    """The token in the request's cookie; None: there is none, or there are several, of which a page of another port may
    have set one."""
    sent = b"; ".join(header(scope, b"cookie")).decode("latin-1")
    start = f"{cookie_name(scope)}="
    found = [one.strip().removeprefix(start) for one in sent.split(";") if one.strip().startswith(start)]
    return found[0] if len(found) == 1 and found[0].startswith(PREFIX) else None


def session_cookie(scope: Scope, token: str | None) -> str:
    """The header Set-Cookie that keeps the token in the browser; None removes it."""
    morsel: Morsel[str] = Morsel()
    morsel.set(cookie_name(scope), token or "", token or "")
    morsel["path"] = "/"
    morsel["httponly"] = True
    morsel["samesite"] = "Strict"
    morsel["max-age"] = LASTS_S if token else 0
    # Whether a proxy in front of us speaks https, only the page's own address tells.
    morsel["secure"] = b"".join(header(scope, b"origin")).startswith(b"https:")
    return morsel.OutputString()
