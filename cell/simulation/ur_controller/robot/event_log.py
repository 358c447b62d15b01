"""What happened in the virtual controller, and when."""

import time
from collections import deque
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

KEPT = 10_000
"""Older events are forgotten: a controller may run for days, and its memory is to stay as it is."""


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened."""

    index: int
    """Counts from 0; gaps only where old events were forgotten."""
    stamp_s: float
    """Seconds of `time.monotonic()`: one clock for all processes of a Linux machine, so that a test's own stamps can
    be compared with it."""
    kind: str
    """As "command", "motion_start", "dashboard"; the package's docstring lists them."""
    details: dict[str, Any]
    """Plain numbers, strings and lists."""


class EventLog:
    """The events, oldest first."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._next = 0

    @property
    def count(self) -> int:
        """How many there were: the next one's number."""
        return self._next

    def add(self, kind: str, stamp_s: float | None = None, **details: Any) -> None:
        """Notes an event, now unless told when."""
        self._events.append(Event(self._next, time.monotonic() if stamp_s is None else stamp_s, kind, details))
        self._next += 1

    def since(self, index: int) -> list[dict[str, Any]]:
        """The events from number `index` on, as plain data."""
        first = self._events[0].index if self._events else 0
        return [asdict(event) for event in islice(self._events, max(0, index - first), None)]
