"""Event hub: carries events from the threads that publish them to the subscribers in the event loop.

Publishing never waits, and takes one wake-up of the event loop for all subscribers. All backlogs are bounded: a
subscriber that does not keep up loses its backlog and gets `Mark.MISSED`.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Generic, TypeVar

T = TypeVar("T")

MAX_BACKLOG = 64
"""Number of events that wait for one subscriber."""
MAX_INBOX = 64 * MAX_BACKLOG
"""Number of events that wait for a delayed event loop."""


class Mark(Enum):
    """Item that a subscriber gets in place of an event."""

    MISSED = "missed"
    """Events were lost here. Read the present state."""
    CLOSED = "closed"
    """No further event will come."""


class Subscriber(Generic[T]):
    """Subscriber of one topic, or of all if `topic` is None. For use in the event loop's thread."""

    def __init__(self, topic: str | None) -> None:
        self.topic = topic
        self._waiting: deque[T | Mark] = deque()
        self._available = asyncio.Event()

    async def next(self, within_s: float | None = None) -> T | Mark | None:
        """Return the next item in order, or None if none comes within `within_s` seconds. None waits without limit."""
        try:
            async with asyncio.timeout(within_s):
                while not self._waiting:
                    self._available.clear()
                    await self._available.wait()
        except TimeoutError:
            return None
        return self._waiting.popleft()

    def put(self, item: T | Mark) -> None:
        """Add an item. If the backlog is full, it and the item are replaced by `Mark.MISSED`."""
        if len(self._waiting) >= MAX_BACKLOG and item is not Mark.CLOSED:
            self._waiting.clear()
            item = Mark.MISSED
        self._waiting.append(item)
        self._available.set()


class EventHub(Generic[T]):
    """Delivers published events to all subscribers. Without subscribers it needs no event loop and keeps nothing."""

    def __init__(self) -> None:
        self._subscribers: set[Subscriber[T]] = set()
        """Used in the event loop's thread only."""
        self._lock = threading.Lock()
        """Guards all members below. It is held only briefly."""
        self._loop: asyncio.AbstractEventLoop | None = None
        """Event loop of the subscribers, or None without subscribers."""
        self._inbox: list[tuple[str | None, T | Mark]] = []
        self._wake_up_pending = False
        self._closed = False

    @property
    def subscribers(self) -> int:
        """Number of subscribers."""
        return len(self._subscribers)

    @property
    def closed(self) -> bool:
        """Whether the hub is closed, so that no further event will come."""
        return self._closed

    def publish(self, topic: str | None, item: T) -> None:
        """Publish an event to the subscribers of its topic and of all topics, in order. Call it from any thread.

        Args:
            topic: Topic of the event. None: only the subscribers of all topics get it.
            item: The event.
        """
        with self._lock:
            if self._loop is None or self._closed:
                return
            if len(self._inbox) >= MAX_INBOX:  # the event loop does not run
                self._inbox = [(None, Mark.MISSED)]
            else:
                self._inbox.append((topic, item))
            self._wake()

    def close(self) -> None:
        """Deliver the events published so far, and then `Mark.CLOSED`. Call it from any thread."""
        with self._lock:
            self._closed = True
            self._wake()

    @contextmanager
    def subscribe(self, topic: str | None) -> Iterator[Subscriber[T]]:
        """Subscribe to all events of a topic that are published while the context is open.

        Enter the context in the event loop's thread.

        Args:
            topic: The topic. None: all topics.
        """
        subscriber: Subscriber[T] = Subscriber(topic)
        with self._lock:
            if self._loop is None:
                self._loop, self._wake_up_pending = asyncio.get_running_loop(), False
            self._subscribers.add(subscriber)
            if self._closed:
                subscriber.put(Mark.CLOSED)
        try:
            yield subscriber
        finally:
            with self._lock:
                self._subscribers.discard(subscriber)
                if not self._subscribers:
                    self._loop, self._inbox = None, []

    def _wake(self) -> None:
        """Schedule a delivery, unless one is pending. The caller holds the lock."""
        if self._loop is None or self._wake_up_pending:
            return
        try:
            self._loop.call_soon_threadsafe(self._deliver)
            self._wake_up_pending = True
        except RuntimeError:  # the loop has ended, and with it all subscribers
            self._loop, self._inbox = None, []

    def _deliver(self) -> None:
        """Move the inbox to the subscribers. Runs in the event loop's thread."""
        with self._lock:
            items, self._inbox, self._wake_up_pending = self._inbox, [], False
            closed = self._closed
        for subscriber in self._subscribers:
            for topic, item in items:
                if isinstance(item, Mark) or subscriber.topic is None or subscriber.topic == topic:
                    subscriber.put(item)
            if closed:
                subscriber.put(Mark.CLOSED)
