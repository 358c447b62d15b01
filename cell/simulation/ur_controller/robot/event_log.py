"""Log of events of the virtual controller."""

import time
from collections import deque
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

KEPT = 10_000
"""Number of events that are kept, so that the memory of a controller stays constant over days."""


@dataclass(frozen=True, slots=True)
class Event:
    """One event."""

    index: int
    """Number of the event, from 0. Gaps occur only where old events were dropped."""
    stamp_s: float
    """Time, seconds of `time.monotonic()`, the clock of all processes of a Linux machine."""
    kind: str
    """Kind, for example "command", "motion_start" or "dashboard". The docstring of the package lists all kinds."""
    details: dict[str, Any]
    """Numbers, strings and lists."""


class EventLog:
    """The events, oldest first."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._next = 0

    @property
    def count(self) -> int:
        """Number of events so far, which is the number of the next one."""
        return self._next

    def add(self, kind: str, stamp_s: float | None = None, **details: Any) -> None:
        """Add an event, with the present time by default."""
        self._events.append(Event(self._next, time.monotonic() if stamp_s is None else stamp_s, kind, details))
        self._next += 1

    def since(self, index: int) -> list[dict[str, Any]]:
        """Return the events from number `index` on as plain data."""
        first = self._events[0].index if self._events else 0
        return [asdict(event) for event in islice(self._events, max(0, index - first), None)]
