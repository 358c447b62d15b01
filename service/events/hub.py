"""News on their way from the thread that makes them to the streams that tell them, in memory.

Whoever publishes waits for nobody, and costs little: one wake-up of the event loop for all who follow. Nobody's backlog
grows without a bound: one who does not keep up loses it, and is told so.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Generic, TypeVar

T = TypeVar("T")

BACKLOG = 64
"""So many news wait for one who follows, and as many times more for a loop that is late."""
INBOX = 64 * BACKLOG


class Mark(Enum):
    """What comes in the place of news."""

    MISSED = "missed"
    """Some were lost here: look at the present state."""
    CLOSED = "closed"
    """There will be no more."""


class Follower(Generic[T]):
    """One who follows a topic, or all of them. For the event loop's thread."""

    def __init__(self, topic: str | None) -> None:
        self.topic = topic
        self._waiting: deque[T | Mark] = deque()
        self._news = asyncio.Event()

    async def next(self, within_s: float | None = None) -> T | Mark | None:
        """What comes next, in order; None when nothing has come in time."""
        try:
            async with asyncio.timeout(within_s):
                while not self._waiting:
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return None
        return self._waiting.popleft()

    def put(self, item: T | Mark) -> None:
        """Adds one; a backlog that is full goes, and with it this one."""
        if len(self._waiting) >= BACKLOG and item is not Mark.CLOSED:
            self._waiting.clear()
            item = Mark.MISSED
        self._waiting.append(item)
        self._news.set()


class EventHub(Generic[T]):
    """Brings what is published to all who follow. Without anybody it needs no event loop, and keeps nothing."""

    def __init__(self) -> None:
        self._followers: set[Follower[T]] = set()
        """For the event loop's thread."""
        self._lock = threading.Lock()
        """Of all that is below; held for moments only."""
        self._loop: asyncio.AbstractEventLoop | None = None
        """While somebody follows."""
        self._inbox: list[tuple[str | None, T | Mark]] = []
        self._woken = False
        self._closed = False

    @property
    def followers(self) -> int:
        """How many follow."""
        return len(self._followers)

    @property
    def closed(self) -> bool:
        """There will be no more news."""
        return self._closed

    def publish(self, topic: str | None, item: T) -> None:
        """For those who follow the topic, or all; `topic` None: for the latter only. From any thread, in order."""
        with self._lock:
            if self._loop is None or self._closed:
                return
            if len(self._inbox) >= INBOX:  # the loop hangs
                self._inbox = [(None, Mark.MISSED)]
            else:
                self._inbox.append((topic, item))
            self._wake()

    def close(self) -> None:
        """Those who follow get what was published so far, and then the end. From any thread."""
        with self._lock:
            self._closed = True
            self._wake()

    @contextmanager
    def following(self, topic: str | None) -> Iterator[Follower[T]]:
        """Follows a topic, None: all, for as long as it lasts; all that is published from its beginning on.

        For the event loop's thread.
        """
        follower: Follower[T] = Follower(topic)
        with self._lock:
            if self._loop is None:
                self._loop, self._woken = asyncio.get_running_loop(), False
            self._followers.add(follower)
            if self._closed:
                follower.put(Mark.CLOSED)
        try:
            yield follower
        finally:
            with self._lock:
                self._followers.discard(follower)
                if not self._followers:
                    self._loop, self._inbox = None, []

    def _wake(self) -> None:
        """With the lock."""
        if self._loop is None or self._woken:
            return
        try:
            self._loop.call_soon_threadsafe(self._deliver)
            self._woken = True
        except RuntimeError:  # the loop has ended, and with it all who followed
            self._loop, self._inbox = None, []

    def _deliver(self) -> None:
        """In the event loop's thread."""
        with self._lock:
            news, self._inbox, self._woken = self._inbox, [], False
            closed = self._closed
        for follower in self._followers:
            for topic, item in news:
                if isinstance(item, Mark) or follower.topic is None or follower.topic == topic:
                    follower.put(item)
            if closed:
                follower.put(Mark.CLOSED)
