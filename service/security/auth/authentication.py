"""Authentication of a request: by the token in its header, by its cookie, or as a local client."""

from dataclasses import dataclass

from starlette.types import Scope

from service.clock import utc_now
from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import is_loopback
from service.security.auth.caller import LOCAL, Caller
from service.security.auth.credential import bearer_token, unauthorized
from service.security.auth.session_cookie import secret_in_cookie
from service.security.auth.sessions import SESSION_PREFIX, SessionFile
from service.security.auth.tokens import Token, TokenFile


@dataclass(frozen=True)
class Identity:
    """The caller of a request, and how the caller was identified."""

    caller: Caller
    by_cookie: bool = False
    """Whether a cookie identified the caller. A browser sends it by itself, whichever page makes the request."""


class Authenticator:
    """Identifies the caller of a request by the current content of the files of tokens and sessions."""

    def __init__(self, tokens: TokenFile, sessions: SessionFile, local: bool) -> None:
        """Create the authenticator.

        Args:
            tokens: The token file.
            sessions: The file of the sessions.
            local: Whether the service listens on loopback only. Then no token is needed while there are no tokens.
        """
        self._tokens, self._sessions, self._local = tokens, sessions, local

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

        A token in the header takes precedence over the cookie. A cookie with a removed token, or with an
        ended session, counts as no cookie.

        Raises:
            ProblemError: The caller is unknown (`unauthorized`).
        """
        if (token := bearer_token(scope)) is not None:
            return Identity(self.caller_of_token(token))
        if (secret := secret_in_cookie(scope)) is not None and (known := self._find(secret)) is not None:
            return Identity(Caller(known.name, known.role), by_cookie=True)
        if self._local and self._tokens.is_empty and _from_loopback(scope):
            return Identity(LOCAL)
        raise unauthorized(
            "this needs a token: make one with `pointchain token add`, and send it as Authorization: Bearer"
        )

    def session_of(self, scope: Scope) -> str | None:
        """Return the secret of the session in the cookie of a request, or None if it has no valid one."""
        secret = secret_in_cookie(scope)
        if secret is None or not secret.startswith(SESSION_PREFIX) or self._find(secret) is None:
            return None
        return secret

    def _find(self, secret: str) -> Token | None:
        """Return the token that is in a cookie, or to which the session in the cookie belongs."""
        if not secret.startswith(SESSION_PREFIX):
            return self._tokens.find(secret)
        token_hash = self._sessions.find_token_hash(secret, utc_now())
        return None if token_hash is None else self._tokens.find_hash(token_hash)

    def identify_or_none(self, scope: Scope) -> Identity | None:
        """Return the caller of a request, or None if the caller is unknown."""
        try:
            return self.identify(scope)
        except ProblemError:
            return None


def _from_loopback(scope: Scope) -> bool:
    client = scope.get("client")
    return client is not None and is_loopback(client[0])
