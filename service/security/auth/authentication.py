"""Who asks, by what a request carries: a token in its header, the same in its cookie, or nothing at all."""

from dataclasses import dataclass

from starlette.types import Scope

from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import is_loopback
from service.security.auth.caller import LOCAL, Caller
from service.security.auth.credential import token_of, unauthorized
from service.security.auth.session_cookie import token_in_cookie
from service.security.auth.tokens import TokenFile


@dataclass(frozen=True)
class Known:
    """Who asks."""

    caller: Caller
    by_cookie: bool = False
    """A browser sends it by itself, whatever page makes it ask."""


class Callers:
    """All who may ask, as the file of tokens has them at that moment."""

    def __init__(self, tokens: TokenFile, local: bool) -> None:
        """`local`: the service listens on loopback alone, where nobody has to say who he is while there is no token."""
        self._tokens, self._local = tokens, local

    def with_token(self, token: str) -> Caller:
        """Whose token it is. Raises ProblemError: `unauthorized`."""
        known = self._tokens.find(token)
        if known is None:
            raise unauthorized("there is no such token, or it was removed: `pointchain token list` has all")
        return Caller(known.name, known.role)

    def known(self, scope: Scope) -> Known:
        """Who asks. A token in the header counts, whatever the cookie says; a cookie whose token is no more is none.

        Raises:
            ProblemError: `unauthorized`.
        """
        if (token := token_of(scope)) is not None:
            return Known(self.with_token(token))
        if (token := token_in_cookie(scope)) is not None and (known := self._tokens.find(token)) is not None:
            return Known(Caller(known.name, known.role), by_cookie=True)
        if self._local and self._tokens.none and _from_loopback(scope):
            return Known(LOCAL)
        raise unauthorized("this needs a token: `pointchain token add` makes one; send it as Authorization: Bearer")

    def known_or_none(self, scope: Scope) -> Known | None:
        """The same; None: nobody knows who asks."""
        try:
            return self.known(scope)
        except ProblemError:
            return None


def _from_loopback(scope: Scope) -> bool:
    client = scope.get("client")
    return client is not None and is_loopback(client[0])
