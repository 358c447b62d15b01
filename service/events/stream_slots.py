"""Limit on concurrent event streams, each of which holds a connection for as long as its client wants."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import ServiceError

RETRY_AFTER_S = 5.0


class StreamSlots:
    """Slots of the open streams, for use in the event loop's thread."""

    def __init__(self, max_total: int, max_per_caller: int) -> None:
        """Create the slots.

        Args:
            max_total: Number of slots.
            max_per_caller: Number of slots that one caller can take.
        """
        self._max_total, self._max_per_caller = max_total, max_per_caller
        self._open: Counter[str | None] = Counter()

    @property
    def open(self) -> int:
        """Number of open streams."""
        return self._open.total()

    @contextmanager
    def acquire(self, caller: str | None) -> Iterator[None]:
        """Hold a slot while the context is open.

        Args:
            caller: Name of the caller. None means that no token was needed; then only the total is limited.

        Raises:
            ServiceError: `too-many-streams`: No slot is free, or the caller has all its slots.
        """
        if caller is not None and self._open[caller] >= self._max_per_caller:
            detail = f"you follow {self._open[caller]} event streams already: close one, or poll instead"
            raise ServiceError("too-many-streams", detail, retry_after_s=RETRY_AFTER_S, streams=self._open[caller])
        if self.open >= self._max_total:
            detail = f"{self.open} event streams are open already: poll instead, or try again later"
            raise ServiceError("too-many-streams", detail, retry_after_s=RETRY_AFTER_S, streams=self.open)
        self._open[caller] += 1
        try:
            yield
        finally:
            self._open[caller] -= 1
            if not self._open[caller]:
                del self._open[caller]
