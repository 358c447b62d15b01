"""Recognition on a Dask cluster: of local processes, or one that already runs."""

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from recognition.request import RecognitionRequest
from service.batch.cluster_worker import VersionMismatchError, recognise_on_worker
from service.batch.errors import INSTALL_EXTRA, BatchError
from service.batch.recognise_file import RecordingLine, failed_line, hash_recording, release
from service.signals import defer_sigint

if TYPE_CHECKING:
    from distributed import Client

SCHEDULER_TIMEOUT_S = 10.0
"""Timeout for connecting to the scheduler."""
WORKER_TIMEOUT_S = 60.0
"""Timeout for the first worker. A worker that was just started imports for several seconds."""


@contextmanager
def local_cluster(jobs: int) -> Iterator[str]:
    """Start a cluster of `jobs` processes, yield its address, and end the processes with the block.

    Raises:
        BatchError: The processes cannot be started, or a package is missing.
    """
    _require_dask()
    import dask.config
    from distributed import LocalCluster

    with ExitStack() as stack:
        # Dask would count a worker as lost that restarts for the third time because of one recording
        stack.enter_context(dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"}))
        try:
            with defer_sigint():
                cluster = LocalCluster(
                    n_workers=jobs,
                    # recognition holds the interpreter lock, and the rounding of sums depends on its threads
                    threads_per_worker=1,
                    # a share of the memory of the machine may be less than the imports take; Dask would wait forever
                    memory_limit=None,
                    host="127.0.0.1",
                    # with None, the scheduler would take port 8787, and warn if another cluster has it
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    silence_logs=logging.CRITICAL,
                    preload="service.batch.cluster_worker",
                )
                stack.enter_context(cluster)
        except (RuntimeError, OSError) as error:
            raise BatchError(f"{jobs} processes cannot be started on this machine: {error}; use fewer") from error
        yield cluster.scheduler_address


def recognise_on_cluster(files: Sequence[str], request: RecognitionRequest, address: str) -> Iterator[RecordingLine]:
    """Yield the line of each file as soon as it is done. The workers must see the files under the same paths.

    If a worker dies, another one gets its recording. A recording that several workers died over, also when it was
    alone, gets a line with the error `recognition-crashed`.

    Args:
        files: Names of the recordings.
        request: How to recognise them.
        address: Address of the scheduler.

    Raises:
        BatchError: No cluster runs at `address`, it has no worker, a worker has no or another version of Pointchain,
            or the cluster was lost.
    """
    _require_dask()

    with _client(address) as client:
        crashed = []
        for file, line in _recognise_each(client, files, request):
            if line is None:
                crashed.append(file)
            else:
                yield line
        # a dying worker takes its other recordings with it; running each alone shows which one is the cause
        for file in crashed:
            for _, line in _recognise_each(client, [file], request):
                reason = (
                    "it crashed one worker after the other: give the workers more memory, or report the error if they "
                    "have enough"
                )
                yield line or failed_line(file, request, "recognition-crashed", reason, hash_recording(_absolute(file)))


def _recognise_each(
    client: "Client", files: Sequence[str], request: RecognitionRequest
) -> Iterator[tuple[str, RecordingLine | None]]:
    """Yield each file with its line as soon as it is done; None if one worker after the other died over it.

    Raises:
        BatchError: As for `recognise_on_cluster`.
    """
    from distributed import CancelledError, KilledWorker, as_completed

    paths = [str(_absolute(file)) for file in files]
    futures = client.map(
        recognise_on_worker, list(files), paths, request=request, expected_release=release(), pure=False
    )
    file_of = {future.key: file for future, file in zip(futures, files, strict=True)}
    completed = as_completed(futures)
    del futures  # the cluster then forgets each result after it was taken
    for future in completed:
        file = file_of.pop(future.key)
        try:
            line = future.result()
        except KilledWorker:
            line = None
        except ImportError as error:
            raise BatchError(f"a worker lacks a package ({error}): install the same release there") from error
        except VersionMismatchError as error:
            raise BatchError(str(error)) from error
        except (CancelledError, OSError) as error:
            raise BatchError(f"the connection to the cluster was lost: {error}; run the command again") from error
        except Exception as error:  # noqa: BLE001 -- an error of one recording must not lose the results of the others
            line = failed_line(
                file, request, "internal", f"unexpected error of a worker: {error!r}", hash_recording(_absolute(file))
            )
        yield file, line


def _absolute(file: str) -> Path:
    return Path(os.path.abspath(file))  # noqa: PTH100 -- resolve() would follow links


@contextmanager
def _client(address: str) -> Iterator["Client"]:
    from distributed import Client

    # the exceptions report every failure, so the log of Dask is not needed
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, timeout=SCHEDULER_TIMEOUT_S))
            client.wait_for_workers(1, WORKER_TIMEOUT_S)
        except TimeoutError as error:
            raise BatchError(f"the cluster at {address} has no worker: start `dask worker {address}`") from error
        except (OSError, ValueError) as error:
            raise BatchError(f"no Dask scheduler answers at {address}: {error}") from error
        yield client


def _require_dask() -> None:
    try:
        import distributed  # noqa: F401 -- checks only whether it is installed
    except ImportError as error:
        raise BatchError(f"--jobs and --cluster need the extra `archive`: {INSTALL_EXTRA}") from error
