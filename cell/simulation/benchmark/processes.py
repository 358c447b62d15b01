"""Work in other processes that end with this one.

Nothing heavy is imported here: a worker must set its number of threads before numpy is.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def in_fresh_process(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """What `function` returns when a new process runs it, with all of the machine's threads."""
    with _pool(1) as pool:
        return pool.submit(function, *args, **kwargs).result()


def in_processes(function: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[R]:
    """`function` of each item, in their order, computed by `jobs` processes.

    A process has one thread for sums: their rounding, and so the result, does not depend on the machine's cores.
    """
    with _pool(jobs, threads=1) as pool:
        yield from pool.map(function, items)


@contextmanager
def _pool(jobs: int, threads: int | None = None) -> Iterator[ProcessPoolExecutor]:
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=_begin, initargs=(threads,))
    try:
        yield pool
    except KeyboardInterrupt:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(threads: int | None) -> None:
    """What a worker does first."""
    if threads is not None:
        os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    # Ctrl-C reaches the terminal's whole group: a worker just ends, and its parent says what happened.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
