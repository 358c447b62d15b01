"""How the processes that this one starts write their log: as it does itself, if somebody has said how.

What it is written by is not known here; it is pickled to the child by its name.
"""

from collections.abc import Callable

SetUp = Callable[[str], None]
"""Sets up the log of the process that it is called in; takes the process's name."""

_set_up: list[SetUp] = []


def in_every_child(set_up: SetUp) -> None:
    """Every child that is started from here on calls `set_up` first. It must be one that can be pickled."""
    _set_up[:] = [set_up]


def child_set_up() -> SetUp | None:
    """What a child has to call; None: nobody has said how to log."""
    return _set_up[0] if _set_up else None
