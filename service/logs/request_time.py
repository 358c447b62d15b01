"""When the request that is being answered arrived: what takes long is counted from there."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_arrived: ContextVar[float | None] = ContextVar("arrived", default=None)
_came: ContextVar[float | None] = ContextVar("came", default=None)


@contextmanager
def having_come(at_s: float | None) -> Iterator[None]:
    """A request that begins to be answered within came then, by `time.monotonic()`, and had to wait; None: just now."""
    token = _came.set(at_s)
    try:
        yield
    finally:
        _came.reset(token)


@contextmanager
def arriving() -> Iterator[float]:
    """The context in which a request is answered, by whichever threads; its arrival, `time.monotonic()`."""
    came = _came.get()
    at = time.monotonic() if came is None else came
    token = _arrived.set(at)
    try:
        yield at
    finally:
        _arrived.reset(token)


def arrived_s() -> float:
    """`time.monotonic()` when the request arrived; where there is none, now."""
    at = _arrived.get()
    return time.monotonic() if at is None else at
