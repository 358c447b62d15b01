"""Handling of SIGINT and SIGTERM in commands, among them those that move the arm."""

import asyncio
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import TypeVar

INTERRUPTED_EXIT_CODE = 130
"""Exit code that shells use for a program ended by Ctrl-C."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)

Result = TypeVar("Result")


def run_with_signal_handler(work: Callable[[], Result], on_signal: Callable[[], None]) -> Result:
    """Run `work` in its own thread, and call `on_signal` in the main thread at the first SIGINT or SIGTERM.

    This also works in a background job of a shell script, where SIGINT is ignored, and if the parent process has
    blocked the signals. Further signals do nothing, unless `on_signal` raised: then the next one calls it again. `work`
    ends in its own time.

    Returns:
        The result of `work`.
    """

    async def wait() -> Result:
        # An event loop, not a future's result(): while other threads work and start processes, the system delivers
        # some signals to one of them (7 of 100 on a busy machine), and a main thread that waits for a lock does not
        # wake up. A pipe wakes the loop.
        loop = asyncio.get_running_loop()
        handled = False

        def handle_once() -> None:
            nonlocal handled
            if not handled:
                on_signal()
                handled = True  # not reached if `on_signal` raises, so that the next signal calls it again

        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        for number in SIGNALS:
            loop.add_signal_handler(number, handle_once)
        return await loop.run_in_executor(pool, work)

    with ThreadPoolExecutor(1) as pool:
        return asyncio.run(wait())


@contextmanager
def block_sigint_for_children() -> Iterator[None]:
    """Start the processes of the block with SIGINT blocked. For the thread that starts them.

    Ctrl-C reaches all processes of a terminal, but this process ends its children itself. The signal is blocked from
    the start, because a process could not handle it while it imports its modules.
    """
    resource_tracker.ensure_running()  # if it started with the first process, it would unblock SIGINT in this thread
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def defer_sigint() -> Iterator[None]:
    """Defer Ctrl-C to the end of the block, for work that cannot be interrupted. For the main thread.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed during the block.
    """
    received: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        received.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if received:
        raise KeyboardInterrupt
