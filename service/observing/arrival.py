"""When the request that is being answered arrived: what takes long is counted from there."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_arrived: ContextVar[float | None] = ContextVar("arrived", default=None)


@contextmanager
def arriving() -> Iterator[float]:
    """The context in which a request is answered, by whichever threads; its arrival, `time.monotonic()`."""
    at = time.monotonic()
    token = _arrived.set(at)
    try:
        yield at
    finally:
        _arrived.reset(token)


def arrived_s() -> float:
    """`time.monotonic()` when the request arrived; where there is none, now."""
    at = _arrived.get()
    return time.monotonic() if at is None else at
