"""What happens again and again is counted, not written each time."""

import threading
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

WINDOW_S = 60.0
KEYS_MOST = 1000
OTHERS = "others"


@dataclass
class _Seen(Generic[T]):
    first: T
    since: float
    more: int = 0


class Repeats(Generic[T]):
    """The first of each kind in a minute is told, the number of the others behind it. Safe to use from any thread."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.window_s = window_s
        self._seen: dict[Hashable, _Seen[T]] = {}
        self._lock = threading.Lock()

    def first(self, kind: Hashable, one: T, now_s: float) -> bool:
        """Whether `one` is the first of its kind; else it is counted. Very many kinds count as one."""
        with self._lock:
            if kind not in self._seen and len(self._seen) >= KEYS_MOST:
                kind = OTHERS
            seen = self._seen.get(kind)
            if seen is None:
                self._seen[kind] = _Seen(one, now_s)
                return True
            seen.more += 1
            return False

    def ended(self, now_s: float, everything: bool = False) -> list[tuple[T, int]]:
        """Of each kind whose minute is over, or of everything: the first one, and how many followed, if any did."""
        with self._lock:
            over = [kind for kind, seen in self._seen.items() if everything or now_s - seen.since >= self.window_s]
            ended = [self._seen.pop(kind) for kind in over]
        return [(seen.first, seen.more) for seen in ended if seen.more]
