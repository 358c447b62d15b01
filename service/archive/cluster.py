"""Recordings recognised on a Dask cluster: one of this machine's processes, or one that is there already."""

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from service.archive.errors import ArchiveError
from service.archive.one_file import Asked, Line, failed
from service.archive.worker import OtherVersionError, work_on

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

    # A worker that starts again for the third time, because of one recording, would be taken for lost.
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"}):
        # One thread a process: recognition holds the interpreter, and how sums are rounded depends on their threads.
        cluster = LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,  # pyright: ignore[reportArgumentType] -- None is its word for none
            silence_logs=logging.CRITICAL,
            preload="service.archive.worker",
        )
        with cluster:
            yield cluster.scheduler_address


def on_cluster(files: Sequence[str], asked: Asked, address: str) -> Iterator[Line]:
    """The line of each file, as they are done. The workers must see the files under the same paths.

    A recording that was being worked on when its worker died is given to another; one that several died over gets a
    line with the error `recognition-crashed`.

    Raises:
        ArchiveError: there is no cluster at `address`, it has no worker, a worker has no or another version of
            Pointchain, or the cluster was lost.
    """
    _require_dask()
    from distributed import CancelledError, KilledWorker, as_completed

    with _client(address) as client:
        paths = [os.path.abspath(file) for file in files]  # noqa: PTH100 -- resolve() would follow links
        futures = client.map(work_on, list(files), paths, asked=asked, pure=False)
        file_of = {future.key: (file, Path(path)) for future, file, path in zip(futures, files, paths, strict=True)}
        coming = as_completed(futures)
        del futures  # what is not held is forgotten by the cluster, once it was taken
        for future in coming:
            file, path = file_of.pop(future.key)
            try:
                yield future.result()
            except KilledWorker as error:
                reason = f"it ended {error.allowed_failures + 1} workers: too little memory, or a fault of ours"
                yield failed(file, asked, "recognition-crashed", reason, path)
            except ImportError as error:
                raise ArchiveError(f"a worker lacks what it needs ({error}): install the same release there") from error
            except OtherVersionError as error:
                raise ArchiveError(str(error)) from error
            except CancelledError as error:
                raise ArchiveError(f"the cluster at {address} was lost") from error


@contextmanager
def _client(address: str) -> Iterator["Client"]:
    from distributed import Client

    # What is wrong is told by what is raised.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
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
        raise ArchiveError("--jobs and --cluster need more packages: pip install 'pointchain[archive]'") from error
