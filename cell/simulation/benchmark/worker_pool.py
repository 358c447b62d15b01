"""Run functions in other processes that end with this one.

Nothing heavy is imported here: a worker must set its number of threads before it imports numpy.
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
    """Run `function` in a new process, with all threads of the machine, and return its result."""
    with _pool(1) as pool:
        return pool.submit(function, *args, **kwargs).result()


def in_processes(function: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[R]:
    """Yield `function` of each item, in their order, computed by `jobs` processes.

    Each process computes with one thread, so that rounding does not depend on the number of cores.
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
    """Set up a worker."""
    if threads is not None:
        os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    # Ctrl-C reaches all processes of the terminal: a worker ends silently, and its parent reports it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
