"""Logging of child processes: they set up their log by the same function as this process.

The function is pickled to the child by its name.
"""

from collections.abc import Callable

LoggingSetup = Callable[[str], None]
"""Sets up the log of the calling process, given the name of the process."""

_set_up: list[LoggingSetup] = []


def configure_child_logging(set_up: LoggingSetup) -> None:
    """Let every child that is started from now on call `set_up` first, which must be picklable."""
    _set_up[:] = [set_up]


def child_logging_setup() -> LoggingSetup | None:
    """Return what a child calls first, or None if nothing was configured."""
    return _set_up[0] if _set_up else None
