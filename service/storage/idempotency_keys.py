"""Idempotency keys: a request that is sent again, since its answer was lost, starts nothing a second time.

A key belongs to the caller who sent it. It is written together with the scan that it was first used for, and goes with
that scan; a request that is refused leaves none behind. It is known for a while only when it was first sent: the arm is
not to move for a wish that is older than the last stop, however often and whoever sends it again.
"""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from service.errors import ServiceError
from service.storage.rows import ScanRow
from service.storage.store import Store

WISH_S = 600.0
"""So long it is known when a refused request was first sent; nobody sends one again by himself for longer."""
MOST_WISHES = 10_000
"""Of so many, the latest."""


@dataclass(frozen=True)
class Key:
    """One request with a key."""

    caller: str
    key: str
    body_sha256: str
    """Of where it was sent to and what it asks for."""


class IdempotencyKeys:
    """The keys of requests that are just being decided on, and those in the store. Safe to use from any thread."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        """Never held while the database is asked."""
        self._undecided: set[tuple[str, str]] = set()
        self._wishes: OrderedDict[tuple[str, str], float] = OrderedDict()
        """When each key that has started nothing was first sent, the latest at the end."""

    @contextmanager
    def first_use(self, key: Key | None, arrived_s: float) -> Iterator[ScanRow | float]:
        """The scan that the key was used for before; or, by `time.monotonic()`, since when it is asked for: then the
        body is the first to use the key, and the only one. `arrived_s` is when this request came.

        Raises:
            ServiceError: `idempotency-mismatch`, the key was used for another request; `idempotency-pending`, another
                request with it is being decided on.
        """
        if key is None:
            yield arrived_s
            return
        name = (key.caller, key.key)
        with self._lock:
            if name in self._undecided:
                raise ServiceError(
                    "idempotency-pending",
                    "the first request with this Idempotency-Key is still being decided on; send it again in a moment",
                    retry_after_s=1.0,
                )
            self._undecided.add(name)
            asked_s = self._first_sent(name, arrived_s)
        try:
            used = self._used_for(key)
            yield asked_s if used is None else used
        finally:
            with self._lock:
                self._undecided.remove(name)

    def _first_sent(self, name: tuple[str, str], arrived_s: float) -> float:
        while self._wishes and next(iter(self._wishes.values())) < arrived_s - WISH_S:
            self._wishes.popitem(last=False)
        asked_s = self._wishes.setdefault(name, arrived_s)
        if len(self._wishes) > MOST_WISHES:
            self._wishes.popitem(last=False)
        return asked_s

    def _used_for(self, key: Key) -> ScanRow | None:
        used = self._store.key(key.caller, key.key)
        if used is None:
            return None
        if used.body_sha256 != key.body_sha256:
            raise ServiceError(
                "idempotency-mismatch",
                f"this Idempotency-Key was used for another request, which started scan {used.scan}; take a new key",
            )
        return self._store.scan(used.scan)
