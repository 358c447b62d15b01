"""The wall clock: the only place where the service reads it, and a detector of steps.

The wall clock may be set at any moment, by a day or by years. No duration is measured with it, and ids rise whatever it
says. A decision that depends on an age waits until the wall clock has agreed with the monotonic clock for a while.
"""

import time
from datetime import UTC, datetime, timedelta

MIN_STEP_S = 60.0
"""Change of the offset between wall clock and monotonic clock beyond which the wall clock was set."""


def utc_now() -> datetime:
    """Return the wall clock time in UTC."""
    return datetime.now(UTC)


def format_utc(moment: datetime, *, up: bool = False) -> str:
    """Return a time as RFC 3339 text in UTC with milliseconds. Such texts sort like the times.

    Args:
        moment: A time with a time zone.
        up: Round up to the next millisecond; otherwise the time is truncated to the millisecond.
    """
    moment = moment.astimezone(UTC)
    if up and moment.microsecond % 1000:
        moment += timedelta(milliseconds=1)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


class ClockStepDetector:
    """Detects when the wall clock is set, by comparison with the monotonic clock. For one thread, which polls it."""

    def __init__(self) -> None:
        self._steady_since_s = time.monotonic()
        self._offset_s = self._read_offset()

    def seconds_since_step(self) -> float:
        """Return the seconds since the first reading, or since the last reading that found a step."""
        offset_s = self._read_offset()
        if abs(offset_s - self._offset_s) > MIN_STEP_S:
            self._steady_since_s = time.monotonic()
        self._offset_s = offset_s
        return time.monotonic() - self._steady_since_s

    @staticmethod
    def _read_offset() -> float:
        """Return the wall clock minus the monotonic clock, seconds."""
        return utc_now().timestamp() - time.monotonic()
