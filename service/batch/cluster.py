"""Recordings recognised on a Dask cluster: one of this machine's processes, or one that is there already."""

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from service.batch.cluster_worker import OtherVersionError, work_on
from service.batch.errors import EXTRA, ArchiveError
from service.batch.recognise_file import Asked, Line, failed
from service.signals import ctrl_c_later

if TYPE_CHECKING:
    from distributed import Client

SCHEDULER_S = 10.0
"""So long an answer of the scheduler is waited for."""
WORKERS_S = 60.0
"""So long the first worker is waited for: one that has just been started imports for some seconds."""


@contextmanager
def local_cluster(jobs: int) -> Iterator[str]:
    """The address of a cluster of `jobs` processes, which end with the block. Raises ArchiveError."""
    _require_dask()
    import dask.config
    from distributed import LocalCluster

    with ExitStack() as stack:
        # A worker that starts again for the third time, because of one recording, would be taken for lost.
        stack.enter_context(dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"}))
        try:
            with ctrl_c_later():
                # One thread a process: recognition holds the interpreter, and how sums are rounded depends on their
                # threads.
                cluster = LocalCluster(
                    n_workers=jobs,
                    threads_per_worker=1,
                    # Else each has its part of the machine's, and waits for ever where that is less than imports take.
                    memory_limit=None,
                    host="127.0.0.1",
                    dashboard_address=None,  # pyright: ignore[reportArgumentType] -- None is its word for none
                    silence_logs=logging.CRITICAL,
                    preload="service.batch.cluster_worker",
                )
                stack.enter_context(cluster)
        except (RuntimeError, OSError) as error:
            raise ArchiveError(f"{jobs} processes cannot be started here: {error}; ask for fewer") from error
        yield cluster.scheduler_address


def on_cluster(files: Sequence[str], asked: Asked, address: str) -> Iterator[Line]:
    """The line of each file, as they are done. The workers must see the files under the same paths.

    A recording that was being worked on when its worker died is given to another; one that several died over, when it
    was alone too, gets a line with the error `recognition-crashed`.

    Raises:
        ArchiveError: there is no cluster at `address`, it has no worker, a worker has no or another version of
            Pointchain, or the cluster was lost.
    """
    _require_dask()

    with _client(address) as client:
        ended = []
        for file, line in _worked_on(client, files, asked):
            if line is None:
                ended.append(file)
            else:
                yield line
        # A worker takes others with it that it had been given as well: who of them did it shows when each is alone.
        for file in ended:
            for _, line in _worked_on(client, [file], asked):
                reason = "it ended one worker after the other: too little memory, or a fault of ours"
                yield line or failed(file, asked, "recognition-crashed", reason, _absolute(file))


def _worked_on(client: "Client", files: Sequence[str], asked: Asked) -> Iterator[tuple[str, Line | None]]:
    """Each file with its line, as they are done; None where one worker after the other died that had it.

    Raises:
        ArchiveError: as `on_cluster`.
    """
    from distributed import CancelledError, KilledWorker, as_completed

    futures = client.map(work_on, list(files), [str(_absolute(file)) for file in files], asked=asked, pure=False)
    file_of = {future.key: file for future, file in zip(futures, files, strict=True)}
    coming = as_completed(futures)
    del futures  # what is not held is forgotten by the cluster, once it was taken
    for future in coming:
        file = file_of.pop(future.key)
        try:
            line = future.result()
        except KilledWorker:
            line = None
        except ImportError as error:
            raise ArchiveError(f"a worker lacks what it needs ({error}): install the same release there") from error
        except OtherVersionError as error:
            raise ArchiveError(str(error)) from error
        except (CancelledError, OSError) as error:
            raise ArchiveError(f"the cluster was lost: {error}") from error
        except Exception as error:  # noqa: BLE001 -- of one recording, which must not take the others' results
            line = failed(file, asked, "internal", f"unexpected error of a worker: {error!r}", _absolute(file))
        yield file, line


def _absolute(file: str) -> Path:
    return Path(os.path.abspath(file))  # noqa: PTH100 -- resolve() would follow links


@contextmanager
def _client(address: str) -> Iterator["Client"]:
    from distributed import Client

    # What is wrong is told by what is raised.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, timeout=SCHEDULER_S))
            client.wait_for_workers(1, WORKERS_S)
        except TimeoutError as error:
            raise ArchiveError(f"the cluster at {address} has no worker: start `dask worker {address}`") from error
        except (OSError, ValueError) as error:
            raise ArchiveError(f"no Dask scheduler answers at {address}: {error}") from error
        yield client


def _require_dask() -> None:
    try:
        import distributed  # noqa: F401 -- only whether it is there
    except ImportError as error:
        raise ArchiveError(f"--jobs and --cluster need the extra `archive`: {EXTRA}") from error
