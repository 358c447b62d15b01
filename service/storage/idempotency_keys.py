"""Idempotency keys: a request that a client repeats, because the answer was lost, starts no second scan.

A key belongs to a caller. It is stored with the scan that it started and removed with it. A refused request stores no
key; only the time of the first such request is remembered for a while, so that a repeated request that is older than
the last stop does not move the arm.
"""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from service.errors import ServiceError
from service.storage.rows import ScanRow
from service.storage.store import Store

REQUEST_MEMORY_S = 600.0
"""How long the time of a refused request is remembered. No client repeats a request for longer without a person."""
MAX_REMEMBERED = 10_000
"""Maximum number of refused requests that are remembered."""


@dataclass(frozen=True)
class Key:
    """A request with an idempotency key."""

    caller: str
    key: str
    body_sha256: str
    """Hash of the path and the body."""


class IdempotencyKeys:
    """The keys of pending requests, and those in the store. Safe to use from any thread."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        """Never held during a database query."""
        self._pending: set[tuple[str, str]] = set()
        self._requests: OrderedDict[tuple[str, str], float] = OrderedDict()
        """Time of the first request with each key that has started no scan, monotonic seconds, the latest last."""

    @contextmanager
    def first_use(self, key: Key | None, requested_at: float) -> Iterator[ScanRow | float]:
        """Reserve a key, and yield the scan that it has started, or the time of the first request with it.

        In the second case no other request can use the key within the context.

        Args:
            key: Key of the request; None if it has none.
            requested_at: Time of this request, monotonic seconds.

        Raises:
            ServiceError: `idempotency-mismatch`, the key was used for another request; `idempotency-pending`, another
                request with it is pending.
        """
        if key is None:
            yield requested_at
            return
        name = (key.caller, key.key)
        with self._lock:
            if name in self._pending:
                raise ServiceError(
                    "idempotency-pending",
                    "the first request with this Idempotency-Key is still being processed; send it again in a moment",
                    retry_after_s=1.0,
                )
            self._pending.add(name)
            first_requested_at = self._first_request(name, requested_at)
        try:
            used = self._used_for(key)
            yield first_requested_at if used is None else used
        finally:
            with self._lock:
                self._pending.remove(name)

    def _first_request(self, name: tuple[str, str], requested_at: float) -> float:
        while self._requests and next(iter(self._requests.values())) < requested_at - REQUEST_MEMORY_S:
            self._requests.popitem(last=False)
        first_requested_at = self._requests.setdefault(name, requested_at)
        if len(self._requests) > MAX_REMEMBERED:
            self._requests.popitem(last=False)
        return first_requested_at

    def _used_for(self, key: Key) -> ScanRow | None:
        used = self._store.key(key.caller, key.key)
        if used is None:
            return None
        if used.body_sha256 != key.body_sha256:
            raise ServiceError(
                "idempotency-mismatch",
                f"this Idempotency-Key was used for another request, which started scan {used.scan}; take a new key",
                scan=used.scan,
            )
        return self._store.scans.get(used.scan)
