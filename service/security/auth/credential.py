"""The token in the header of a request."""

from starlette.types import Scope

from service.problems.problem_error import ProblemError

CHALLENGE = {"WWW-Authenticate": 'Bearer realm="pointchain"'}


def header_values(scope: Scope, name: bytes) -> list[bytes]:
    """Return all values of a header, whose name is given in lower case."""
    return [value for known, value in scope["headers"] if known == name]


def bearer_token(scope: Scope) -> str | None:
    """Return the token in the header `Authorization: Bearer TOKEN`, or None if there is no such header.

    Raises:
        ProblemError: The header has another form, or is repeated (`unauthorized`).
    """
    values = header_values(scope, b"authorization")
    if not values:
        return None
    scheme, _, token = values[0].decode("latin-1").strip().partition(" ")
    if len(values) > 1 or scheme.lower() != "bearer" or not token.strip():
        raise unauthorized("the request must have the header Authorization once, as `Bearer TOKEN`")
    return token.strip()


def unauthorized(detail: str) -> ProblemError:
    """Return the error for a request whose caller is unknown."""
    return ProblemError("unauthorized", detail, CHALLENGE)
