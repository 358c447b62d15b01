"""The token that a request carries. The only place that knows where in a request it is."""

from starlette.types import Scope

from service.problems.problem_error import ProblemError

CHALLENGE = {"WWW-Authenticate": 'Bearer realm="pointchain"'}


def header(scope: Scope, name: bytes) -> list[bytes]:
    """All values of a header, named in lower case."""
    return [value for known, value in scope["headers"] if known == name]


def token_of(scope: Scope) -> str | None:
    """The token in the header `Authorization: Bearer TOKEN`; None: there is none.

    Raises:
        ProblemError: `unauthorized`, the header has something else.
    """
    given = header(scope, b"authorization")
    if not given:
        return None
    scheme, _, token = given[0].decode("latin-1").strip().partition(" ")
    if len(given) > 1 or scheme.lower() != "bearer" or not token.strip():
        raise unauthorized("the header Authorization must be `Bearer TOKEN`, once")
    return token.strip()


def unauthorized(detail: str) -> ProblemError:
    """The refusal of somebody who is not known."""
    return ProblemError("unauthorized", detail, CHALLENGE)
