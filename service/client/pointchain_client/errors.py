"""Errors of the client."""

from collections.abc import Mapping
from typing import Any

import httpx2

from service.api.schemas.problem import Problem
from service.api.schemas.scans import ScanResource

NOT_SENT_ERRORS = (httpx2.ConnectError, httpx2.ConnectTimeout, httpx2.PoolTimeout)
"""Errors after which the service has not received the request. After any other transport error, it may have."""
GATEWAY_STATUSES = frozenset({502, 503, 504})
"""Statuses of a proxy whose service is down or does not answer in time."""


class ClientError(Exception):
    """Base of all errors of the client."""


class ProblemError(ClientError):
    """The service refused a request. Programs decide on `slug`, for example `cell-busy`."""

    def __init__(self, problem: Problem, retry_after_s: float | None = None) -> None:
        super().__init__(f"{problem.title}: {problem.detail}")
        self.problem = problem
        self.retry_after_s = retry_after_s
        """Time after which to try again, seconds. None if the service gives none."""

    @property
    def slug(self) -> str:
        """Type of the problem, without its prefix, for example `cell-busy`."""
        return self.problem.type.removeprefix("urn:pointchain:")


class ScanFailedError(ClientError):
    """The scan has no model. `scan` has its state and the reason."""

    def __init__(self, scan: ScanResource) -> None:
        reason = "" if scan.problem is None else f": {scan.problem.detail}"
        super().__init__(f"scan {scan.id} is {scan.state}{reason}")
        self.scan = scan

    @property
    def slug(self) -> str | None:
        """Type of the problem, without its prefix, or None if the scan has no problem."""
        return None if self.scan.problem is None else self.scan.problem.type.removeprefix("urn:pointchain:")


class UnreachableError(ClientError):
    """The service cannot be reached, or does not answer."""


class GatewayError(UnreachableError):
    """A proxy answered in place of the service. The service may have received the request."""


class UnansweredError(UnreachableError):
    """No answer came, so a scan may have been started.

    `Client.start(error.request, error.key)` finds the scan, or starts it if it was not started.
    """

    def __init__(self, request: Mapping[str, Any], key: str, reason: Exception) -> None:
        super().__init__(
            f"the scan may have been started ({reason}): check the cell, then start again with key={key!r}"
        )
        self.request = request
        """Body of `POST /api/scans`."""
        self.key = key
        """Idempotency key of the request."""


class NotEndedError(ClientError, TimeoutError):
    """The scan has not ended within the time limit. It continues; `Client.wait(error.scan_id)` waits for its end."""

    def __init__(self, scan_id: str) -> None:
        super().__init__(f"scan {scan_id} has not ended within the time limit and continues: wait again, or cancel it")
        self.scan_id = scan_id


def require_success(answer: httpx2.Response) -> httpx2.Response:
    """Return the response if it is not an error.

    Raises:
        ProblemError: The response is a problem document.
        GatewayError: A proxy reports that the service is down or does not answer in time.
        UnreachableError: The response is an error that does not come from the service.
    """
    if not answer.is_error:
        return answer
    answer.read()
    if answer.headers.get("content-type", "").startswith("application/problem+json"):
        after_s = answer.headers.get("retry-after", "")
        raise ProblemError(Problem.model_validate(answer.json()), float(after_s) if after_s.isdecimal() else None)
    if answer.status_code in GATEWAY_STATUSES:
        raise GatewayError(
            f"{answer.url} answered {answer.status_code}: the proxy does not reach the service; try again later"
        )
    raise UnreachableError(
        f"{answer.url} answered {answer.status_code} and does not seem to be the service: check the address"
    )
