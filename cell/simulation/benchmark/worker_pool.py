"""Run functions in child processes that exit when this process exits.

This module does not import numpy, because a worker sets its number of threads before it imports numpy.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from cell.process.python_process import exit_with_parent

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables of the number of threads of the linear algebra libraries."""


def run_in_fresh_process(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Run `function` in a new child process, and return its result.

    The child process has the environment of this process, and so the same number of threads.

    Args:
        function: Function to run. It must be picklable.
        *args: Arguments of the function, picklable.
        **kwargs: Keyword arguments of the function, picklable.
    """
    with _pool(1) as pool:
        return pool.submit(function, *args, **kwargs).result()


def map_in_processes(function: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[R]:
    """Apply `function` to each item in child processes.

    Each process computes with one thread, so that rounding does not depend on the number of cores.

    Args:
        function: Function to run. It must be picklable.
        items: Arguments, picklable.
        jobs: Number of child processes.

    Yields:
        Result of each item, in the order of the items.
    """
    with _pool(jobs, threads=1) as pool:
        yield from pool.map(function, items)


@contextmanager
def _pool(jobs: int, threads: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of child processes. None for `threads` keeps the number of threads of the environment."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=_initialise_worker, initargs=(threads,))
    try:
        yield pool
    except KeyboardInterrupt:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _initialise_worker(threads: int | None) -> None:
    """Prepare a worker process: its threads, its reaction to Ctrl-C, and its exit with the parent process."""
    if threads is not None:
        os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    # The terminal sends Ctrl-C to all processes. A worker exits without a traceback, and the parent process reports it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None
    exit_with_parent(parent.sentinel)
