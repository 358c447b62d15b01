"""A counter of repeated events, of which only the first one and their number are written."""

import threading
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

WINDOW_S = 60.0
MAX_KINDS = 1000
OTHERS = "others"
"""Common kind of all events after `MAX_KINDS` kinds."""


@dataclass
class _Repeated(Generic[T]):
    first: T
    since_s: float
    repeats: int = 0


class RepeatCounter(Generic[T]):
    """Counts how often an event of each kind is repeated within a window of time. Safe to use from any thread."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.window_s = window_s
        self._counts: dict[Hashable, _Repeated[T]] = {}
        self._lock = threading.Lock()

    def is_first(self, kind: Hashable, event: T, now_s: float) -> bool:
        """Return whether the event is the first of its kind; if not, count it.

        Args:
            kind: Kind of the event. After `MAX_KINDS` kinds, all further kinds count as one.
            event: The event.
            now_s: Time of the event, monotonic seconds.
        """
        with self._lock:
            if kind not in self._counts and len(self._counts) >= MAX_KINDS:
                kind = OTHERS
            count = self._counts.get(kind)
            if count is None:
                self._counts[kind] = _Repeated(event, now_s)
                return True
            count.repeats += 1
            return False

    def pop_ended(self, now_s: float, everything: bool = False) -> list[tuple[T, int]]:
        """Remove the kinds whose window has ended, and return those with repeats.

        Args:
            now_s: Current time, monotonic seconds.
            everything: Whether to remove all kinds.

        Returns:
            The first event of each kind, and the number of its repeats.
        """
        with self._lock:
            kinds = [k for k, count in self._counts.items() if everything or now_s - count.since_s >= self.window_s]
            ended = [self._counts.pop(kind) for kind in kinds]
        return [(count.first, count.repeats) for count in ended if count.repeats]
