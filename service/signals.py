"""What a command does when it is told to end while the arm may move."""

import asyncio
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import TypeVar

STOPPED_CODE = 130
"""Exit code, as a shell has it for what Ctrl-C ended."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)

Result = TypeVar("Result")


def with_signals(work: Callable[[], Result], at_signal: Callable[[], None]) -> Result:
    """What `work` gives, in a thread of its own; at the first SIGINT or SIGTERM the main thread does `at_signal`.

    Also where a shell script ignores SIGINT for what runs in the background, and where the parent has blocked them.
    Further signals do nothing: `work` ends in its own time.
    """

    async def wait() -> Result:
        # An event loop, and not a future's result(): while other threads work and start processes, the system hands
        # some of the signals to one of them (7 of 100 on a busy machine), and a main thread that waits for a lock
        # does not learn of it. The loop is woken by a pipe.
        loop = asyncio.get_running_loop()
        told = False

        def once() -> None:
            nonlocal told
            if not told:
                at_signal()
                told = True  # one that failed is tried again by the next signal

        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        for number in SIGNALS:
            loop.add_signal_handler(number, once)
        return await loop.run_in_executor(pool, work)

    with ThreadPoolExecutor(1) as pool:
        return asyncio.run(wait())


@contextmanager
def ctrl_c_is_ours() -> Iterator[None]:
    """Processes that are started in the block by this thread do not hear of Ctrl-C, which reaches all processes of a
    terminal: this one ends them. Not even while they import, before they could see to it themselves."""
    resource_tracker.ensure_running()  # started with the first process, it would have the thread hear of it again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ctrl_c_later() -> Iterator[None]:
    """Ctrl-C takes effect behind the block, for what cannot be broken off. For the main thread."""
    pressed: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        pressed.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt
