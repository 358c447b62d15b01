"""The arrival time of the current request. Timing and the order of requests and stops are based on it."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_arrival_s: ContextVar[float | None] = ContextVar("arrival", default=None)
_received_s: ContextVar[float | None] = ContextVar("received", default=None)


@contextmanager
def request_received_at(time_s: float | None) -> Iterator[None]:
    """Set the arrival time of a request whose answer begins in the body, because it had to wait.

    Args:
        time_s: Time at which the request was received, seconds of `time.monotonic()`. None: when its answer begins.
    """
    token = _received_s.set(time_s)
    try:
        yield
    finally:
        _received_s.reset(token)


@contextmanager
def request_arrival() -> Iterator[float]:
    """Record the arrival time of a request for its context, in every thread that answers it.

    Yields:
        The arrival time, seconds of `time.monotonic()`.
    """
    received_s = _received_s.get()
    arrival_s = time.monotonic() if received_s is None else received_s
    token = _arrival_s.set(arrival_s)
    try:
        yield arrival_s
    finally:
        _arrival_s.reset(token)


def arrival_time() -> float:
    """Return the arrival time of the current request, monotonic seconds; without a request, the time now."""
    arrival_s = _arrival_s.get()
    return time.monotonic() if arrival_s is None else arrival_s
