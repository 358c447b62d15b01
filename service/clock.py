"""The wall clock: the one place where the service reads it, and whether it can be believed.

It may be set at any moment, by a day or by years. Nothing is timed by it, ids rise whatever it says, and what is to be
decided by an age waits until it has kept pace with the monotonic clock for a while.
"""

import time
from datetime import UTC, datetime, timedelta

STEP_S = 60.0
"""Between two looks it may lose or gain so much; more means that it was set."""


def present() -> datetime:
    """The present moment, as far as the machine knows it, in UTC."""
    return datetime.now(UTC)


def stamp(moment: datetime, *, up: bool = False) -> str:
    """A moment as it is written everywhere, so that the texts compare as the moments do: RFC 3339 in UTC, cut to the
    millisecond, or rounded `up` to the next one."""
    moment = moment.astimezone(UTC)
    if up and moment.microsecond % 1000:
        moment += timedelta(milliseconds=1)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Steadiness:
    """For how long the wall clock has not been set. Belongs to one thread, which looks now and then."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()
        self._ahead_s = self._ahead()

    def seconds(self) -> float:
        """Since the first look, or since the clock was last found to be set."""
        ahead = self._ahead()
        if abs(ahead - self._ahead_s) > STEP_S:
            self._began_s = time.monotonic()
        self._ahead_s = ahead
        return time.monotonic() - self._began_s

    @staticmethod
    def _ahead() -> float:
        """Of the monotonic clock."""
        return present().timestamp() - time.monotonic()
