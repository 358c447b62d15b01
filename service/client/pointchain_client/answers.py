"""Interpretation of the answers of the service."""

from typing import Any, TypeVar

import httpx2

from pointchain_client.documents.decoding import DecodeError, decode
from pointchain_client.documents.scans import Problem
from pointchain_client.errors import AnswerError, GatewayError, ProblemError, UnreachableError

T = TypeVar("T")

NOT_SENT_ERRORS = (httpx2.ConnectError, httpx2.ConnectTimeout, httpx2.PoolTimeout, httpx2.UnsupportedProtocol)
"""Errors after which the service has not received the request. After any other transport error, it may have."""
GATEWAY_STATUSES = frozenset({502, 503, 504})
"""Statuses of a proxy whose service is down or does not answer in time."""
PROBLEM_TYPE = "application/problem+json"
"""Media type of problem documents."""


def require_success(answer: httpx2.Response) -> httpx2.Response:
    """Return the response if its status is a success. The content of another response must have been read.

    Raises:
        ProblemError: The response is a problem document.
        GatewayError: A proxy reports that the service is down or does not answer in time.
        UnreachableError: The response is an error or a redirection that does not come from the service.
        AnswerError: The response claims to be a problem document and is none.
    """
    if answer.is_success:
        return answer
    if answer.headers.get("content-type", "").startswith(PROBLEM_TYPE):
        after_s = answer.headers.get("retry-after", "")
        raise ProblemError(_decode(Problem, answer), float(after_s) if after_s.isdecimal() else None)
    if answer.status_code in GATEWAY_STATUSES:
        raise GatewayError(
            f"{answer.url} answered {answer.status_code}: the proxy does not reach the service; try again later"
        )
    raise UnreachableError(
        f"{answer.url} answered {answer.status_code} and does not seem to be the service: check the address"
    )


def json_of(answer: httpx2.Response) -> Any:
    """Return the JSON value of a successful response.

    Raises:
        AnswerError: The content is not JSON.
        ProblemError: As for `require_success`.
        UnreachableError: As for `require_success`.
    """
    return _json(require_success(answer))


def document_of(kind: type[T], answer: httpx2.Response) -> T:
    """Return the document of a successful response as an object of a dataclass.

    Raises:
        AnswerError: The content is not such a document.
        ProblemError: As for `require_success`.
        UnreachableError: As for `require_success`.
    """
    return _decode(kind, require_success(answer))


def decoded(kind: type[T], value: Any, source: str) -> T:
    """Return a JSON value as an object of a dataclass.

    Args:
        kind: The dataclass.
        value: The JSON value.
        source: Where the value comes from, for the message.

    Raises:
        AnswerError: The value has another form.
    """
    try:
        return decode(kind, value)
    except DecodeError as error:
        raise AnswerError(f"{source} did not answer with a {kind.__name__}: {error}") from error


def _decode(kind: type[T], answer: httpx2.Response) -> T:
    return decoded(kind, _json(answer), str(answer.url))


def _json(answer: httpx2.Response) -> Any:
    try:
        return answer.json()
    except ValueError as error:
        raise AnswerError(f"{answer.url} did not answer with JSON ({error}): check the address") from error
