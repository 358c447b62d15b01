"""So many event streams at a time, and no more: each holds a connection for as long as its client likes."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.errors import ServiceError

RETRY_AFTER_S = 5.0


class StreamSlots:
    """Counts the open streams. For the event loop's thread."""

    def __init__(self, in_all: int, each: int) -> None:
        """`each`: so many for one caller."""
        self._in_all, self._each = in_all, each
        self._open: Counter[str | None] = Counter()

    @property
    def open(self) -> int:
        """How many streams are open."""
        return self._open.total()

    @contextmanager
    def taken(self, caller: str | None) -> Iterator[None]:
        """A slot for as long as it lasts; `caller` None: nobody had to say who he is, so that only all are counted.

        Raises:
            ServiceError: `too-many-streams`.
        """
        if caller is not None and self._open[caller] >= self._each:
            detail = f"you follow {self._open[caller]} event streams already: close one, or ask at intervals instead"
            raise ServiceError("too-many-streams", detail, retry_after_s=RETRY_AFTER_S)
        if self.open >= self._in_all:
            detail = f"{self.open} event streams are open already: ask at intervals instead, or try again later"
            raise ServiceError("too-many-streams", detail, retry_after_s=RETRY_AFTER_S)
        self._open[caller] += 1
        try:
            yield
        finally:
            self._open[caller] -= 1
            if not self._open[caller]:
                del self._open[caller]
