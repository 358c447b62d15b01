"""What a command does when it is told to end while the arm may move."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STOPPED_CODE = 130
"""Exit code, as a shell has it for what Ctrl-C ended."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def at_a_signal(do: Callable[[], None]) -> Iterator[None]:
    """SIGTERM, and SIGINT also where a shell script ignores it for what runs in the background, do this, once."""

    def once(*_: object) -> None:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        do()

    before = {number: signal.signal(number, once) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
