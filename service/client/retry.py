"""How long a program waits for a service that is away for a moment."""

import time

import httpx
from httpx_sse import SSEError

from service.client.errors import AwayError, NotEndedError, ProblemError, UnreachableError

CONNECT_S = 5.0
QUIET_S = 45.0
"""The service sends something at least every 15 s; a connection that is silent for so long is dead."""
AGAIN_S = 0.5
"""Before the service is asked again."""
LOST_S = 60.0
"""For so long a service that does not answer is asked again: it may be starting anew."""
LAST_S = 0.05
"""Left to an answer at least, however near the deadline is."""
FOR_NOW = frozenset({"not-ready", "busy"})
"""Refusals of a service that is just ending or starting, or whose database another program holds."""
LOST = (httpx.TransportError, SSEError, AwayError, ProblemError)
"""What may be for now: `Patience.pause` knows."""


class Patience:
    """That of one who waits for the scan at `address`, over lost connections and a restart of the service."""

    def __init__(self, http: httpx.Client, address: str, deadline: float | None) -> None:
        """`deadline` of `time.monotonic()`."""
        self._service, self._address, self._deadline = http.base_url, address, deadline
        self._heard = time.monotonic()
        self.lost_s = LOST_S

    def heard(self) -> None:
        """The service is there."""
        self._heard = time.monotonic()

    @property
    def timeout(self) -> httpx.Timeout:
        """Of one request: no longer than to the deadline."""
        left_s = QUIET_S if self._deadline is None else min(QUIET_S, max(LAST_S, self._deadline - time.monotonic()))
        return httpx.Timeout(left_s, connect=min(left_s, CONNECT_S))

    def refuse_late(self) -> None:
        """Raises NotEndedError once the deadline has come."""
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise NotEndedError(self._address.rsplit("/", 1)[-1])

    def pause(self, error: Exception | None = None) -> None:
        """Before the service is asked again, because of one of `LOST` or since there is nothing new.

        Raises:
            ProblemError: the error, which is one for good.
            UnreachableError: nothing was heard for `lost_s`.
            NotEndedError: the deadline has come.
        """
        if isinstance(error, ProblemError) and error.slug not in FOR_NOW:
            raise error
        if error is not None and time.monotonic() - self._heard > self.lost_s:
            raise UnreachableError(f"{self._service} has not answered for {self.lost_s:.0f} s: {error}") from error
        self.refuse_late()
        time.sleep(AGAIN_S)
