"""Retries of a program that waits for a scan while the service is temporarily unreachable."""

import time

import httpx2

from pointchain_client.errors import GatewayError, NotEndedError, ProblemError, UnreachableError

CONNECT_TIMEOUT_S = 5.0
"""Timeout of connecting to the service."""
READ_TIMEOUT_S = 45.0
"""Timeout of reading. The service sends something at least every 15 s, so a connection silent for this time is dead."""
RETRY_INTERVAL_S = 0.5
"""Pause before the next request."""
MAX_OUTAGE_S = 60.0
"""Time for which requests are repeated without an answer. The service may be restarting."""
MIN_TIMEOUT_S = 0.05
"""Shortest timeout of a request, however near the deadline is."""
TEMPORARY_PROBLEMS = frozenset({"not-ready", "busy"})
"""Problems of a service that is starting or stopping, or whose database another program has locked."""
RETRYABLE_ERRORS = (httpx2.RequestError, GatewayError, ProblemError)
"""Errors that may be temporary. `RetryPolicy.raise_unless_retryable` decides.

An answer that is not a stream of events is a `RequestError` too.
"""


class RetryPolicy:
    """Timeouts and retries of waiting for a scan, across lost connections and a restart of the service."""

    def __init__(self, service: str, path: str, deadline: float | None) -> None:
        """Create the policy.

        Args:
            service: Address of the service, for messages.
            path: Path of the scan.
            deadline: Time at which waiting ends, in seconds of `time.monotonic()`. None: no limit.
        """
        self._service, self._path, self._deadline = service, path, deadline
        self._last_contact = time.monotonic()
        self.max_outage_s = MAX_OUTAGE_S
        """Time without an answer after which waiting fails, seconds."""

    def record_contact(self) -> None:
        """Record that the service has answered now."""
        self._last_contact = time.monotonic()

    @property
    def timeout(self) -> httpx2.Timeout:
        """Timeout of one request, limited by the deadline."""
        left_s = (
            READ_TIMEOUT_S
            if self._deadline is None
            else min(READ_TIMEOUT_S, max(MIN_TIMEOUT_S, self._deadline - time.monotonic()))
        )
        return httpx2.Timeout(left_s, connect=min(left_s, CONNECT_TIMEOUT_S))

    def raise_if_expired(self) -> None:
        """Raise NotEndedError if the deadline has passed."""
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise NotEndedError(self._path.rsplit("/", 1)[-1])

    def raise_unless_retryable(self, error: Exception | None = None) -> None:
        """Raise an error if there must be no next request.

        Args:
            error: The error of the last request, one of `RETRYABLE_ERRORS`. None: the request succeeded.

        Raises:
            ProblemError: The error is a problem that is not temporary.
            UnreachableError: The service has not answered for `max_outage_s`.
            NotEndedError: The deadline has passed.
        """
        if isinstance(error, ProblemError) and error.slug not in TEMPORARY_PROBLEMS:
            raise error
        if error is not None and time.monotonic() - self._last_contact > self.max_outage_s:
            raise UnreachableError(
                f"{self._service} has not answered for {self.max_outage_s:.0f} s ({error}): try again later"
            ) from error
        self.raise_if_expired()
