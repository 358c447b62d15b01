"""Authentication of a request: by the token in its header, by the token in its cookie, or as a local client."""

from dataclasses import dataclass

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import is_loopback
from service.security.auth.caller import LOCAL, Caller
from service.security.auth.credential import bearer_token, unauthorized
from service.security.auth.session_cookie import token_in_cookie
from service.security.auth.tokens import TokenFile


@dataclass(frozen=True)
class Identity:
    """The caller of a request, and how the caller was identified."""

    caller: Caller
    by_cookie: bool = False
    """Whether a cookie identified the caller. A browser sends it by itself, whichever page makes the request."""


class Authenticator:
    """Identifies the caller of a request by the current content of the token file."""

    def __init__(self, tokens: TokenFile, local: bool) -> None:
        """Create the authenticator.

        Args:
            tokens: The token file.
            local: Whether the service listens on loopback only. Then no token is needed while there are no tokens.
        """
        self._tokens, self._local = tokens, local

    def caller_of_token(self, token: str) -> Caller:
        """Return the caller with a token.

        Raises:
            ProblemError: The token is unknown (`unauthorized`).
        """
        known = self._tokens.find(token)
        if known is None:
            raise unauthorized("there is no such token, or it was removed: `pointchain token list` shows all tokens")
        return Caller(known.name, known.role)

    def identify(self, scope: Scope) -> Identity:
        """Return the caller of a request.

        A token in the header takes precedence over the cookie. A cookie with a removed token counts as no cookie.

        Raises:
            ProblemError: The caller is unknown (`unauthorized`).
        """
        if (token := bearer_token(scope)) is not None:
            return Identity(self.caller_of_token(token))
        if (token := token_in_cookie(scope)) is not None and (known := self._tokens.find(token)) is not None:
            return Identity(Caller(known.name, known.role), by_cookie=True)
        if self._local and self._tokens.is_empty and _from_loopback(scope):
            return Identity(LOCAL)
        raise unauthorized(
            "this needs a token: make one with `pointchain token add`, and send it as Authorization: Bearer"
        )

    def identify_or_none(self, scope: Scope) -> Identity | None:
        """Return the caller of a request, or None if the caller is unknown."""
        try:
            return self.identify(scope)
        except ProblemError:
            return None


def _from_loopback(scope: Scope) -> bool:
    client = scope.get("client")
    return client is not None and is_loopback(client[0])
