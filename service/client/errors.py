"""Errors of the client."""

from collections.abc import Mapping
from typing import Any

import httpx

from service.api.schemas.problem import Problem
from service.api.schemas.scans import ScanResource

NOT_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)
"""With these the service has not got the request; with any other loss it may have."""
AWAY = frozenset({502, 503, 504})
"""What a proxy answers while the service behind it is away, or when that does not answer in time."""


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


class AwayError(UnreachableError):
    """A proxy answered in place of the service. The service may have received the request."""


class UnansweredError(UnreachableError):
    """No answer came, so a scan may have been started.

    `Client.start(error.wish, error.key)` finds the scan, or starts it if it was not started.
    """

    def __init__(self, wish: Mapping[str, Any], key: str, reason: Exception) -> None:
        super().__init__(
            f"whether the scan was begun is not known ({reason}): look at the cell, then ask again with key={key!r}"
        )
        self.wish = wish
        self.key = key


class NotEndedError(ClientError, TimeoutError):
    """The scan has not ended within the time limit. It continues; `Client.wait(error.scan_id)` waits for its end."""

    def __init__(self, scan_id: str) -> None:
        super().__init__(f"the time to wait for scan {scan_id} is over; it goes on: cancel or stop it")
        self.scan_id = scan_id


def require_success(answer: httpx.Response) -> httpx.Response:
    """The answer, if it is no error.

    Raises:
        ProblemError: it is a problem.
        AwayError: it is a proxy's, for now.
        UnreachableError: it is an error of something else than the service.
    """
    if not answer.is_error:
        return answer
    answer.read()
    if answer.headers.get("content-type", "").startswith("application/problem+json"):
        after_s = answer.headers.get("retry-after", "")
        raise ProblemError(Problem.model_validate(answer.json()), float(after_s) if after_s.isdecimal() else None)
    if answer.status_code in AWAY:
        raise AwayError(f"{answer.url} answered {answer.status_code}: the service is not there behind it")
    raise UnreachableError(f"{answer.url} answered {answer.status_code}, and it does not seem to be the service")
