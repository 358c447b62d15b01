"""Errors of the client."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the documents raise errors of this module
    from pointchain_client.documents.scans import Problem, Scan


class ClientError(Exception):
    """Base of all errors of the client."""


class ProblemError(ClientError):
    """The service refused a request. Programs decide on `slug`, for example `cell-busy`."""

    def __init__(self, problem: "Problem", retry_after_s: float | None = None) -> None:
        super().__init__(f"{problem.title}: {problem.detail}")
        self.problem = problem
        """The problem document."""
        self.retry_after_s = retry_after_s
        """Time after which to try again, seconds. None if the service gives none."""

    @property
    def slug(self) -> str:
        """Type of the problem, without its prefix, for example `cell-busy`."""
        return self.problem.slug


class ScanFailedError(ClientError):
    """The scan has no model. `scan` has its state and the reason."""

    def __init__(self, scan: "Scan") -> None:
        reason = "" if scan.problem is None else f": {scan.problem.detail}"
        super().__init__(f"scan {scan.id} is {scan.state}{reason}")
        self.scan = scan
        """The scan."""

    @property
    def slug(self) -> str | None:
        """Type of the problem, without its prefix, or None if the scan has no problem."""
        return None if self.scan.problem is None else self.scan.problem.slug


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
        """Id of the scan."""


class AnswerError(ClientError, ValueError):
    """An answer is not a document of the service. The message names the member at fault."""


class ModelError(ClientError, ValueError):
    """A document is not a model of schema `pointchain/2`. The message names the member at fault."""
