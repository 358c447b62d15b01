"""The cookie with which a browser authenticates. No script of a page can read it.

It contains the token itself, or the secret of a session that was made with a code. Both are checked by files. While
another program has locked the database, a person who is signed in must still be able to stop the arm.
"""

from http.cookies import Morsel
from urllib.parse import urlsplit

from starlette.types import Scope

from service.security.auth.credential import header_values
from service.security.auth.sessions import SESSION_LIFETIME, SESSION_PREFIX
from service.security.auth.tokens import PREFIX

MAX_AGE_S = int(SESSION_LIFETIME.total_seconds())
"""Lifetime of the cookie. After it, the person must sign in again."""


def cookie_name(scope: Scope) -> str:
    """Return the name of the cookie. It has the port, because browsers share cookies between all ports of a host."""
    (host,) = header_values(scope, b"host")
    try:
        port = urlsplit(f"//{host.decode('latin-1')}").port
    except ValueError:
        port = None
    return "pointchain" if port is None else f"pointchain_{port}"


def secret_in_cookie(scope: Scope) -> str | None:
    """Return the token or the secret of a session in the cookie of a request, or None.

    It is None without a cookie, and with several of this name: a page of another port may have set one of them.
    """
    sent = b"; ".join(header_values(scope, b"cookie")).decode("latin-1")
    start = f"{cookie_name(scope)}="
    found = [one.strip().removeprefix(start) for one in sent.split(";") if one.strip().startswith(start)]
    return found[0] if len(found) == 1 and found[0].startswith((PREFIX, SESSION_PREFIX)) else None


def session_cookie(scope: Scope, secret: str | None) -> str:
    """Return the value of the header Set-Cookie that stores a secret in the browser; None removes the cookie."""
    morsel: Morsel[str] = Morsel()
    morsel.set(cookie_name(scope), secret or "", secret or "")
    morsel["path"] = "/"
    morsel["httponly"] = True
    morsel["samesite"] = "Strict"
    morsel["max-age"] = MAX_AGE_S if secret else 0
    # A proxy may handle HTTPS, so only the origin of the page shows whether the browser uses it.
    morsel["secure"] = b"".join(header_values(scope, b"origin")).startswith(b"https:")
    return morsel.OutputString()
