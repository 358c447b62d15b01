"""The task that a worker of the Dask cluster runs."""

import signal
from pathlib import Path

from service.batch.recognise_file import RecognitionRequest, RecordingLine, recognise_file


class VersionMismatchError(Exception):
    """A worker has another version, so its models must not be mixed with those of this run."""


def recognise_on_worker(file: str, path: str, request: RecognitionRequest) -> RecordingLine:
    """Recognise a recording.

    Args:
        file: Name of the recording, for the line.
        path: The file.
        request: How to recognise it.

    Raises:
        VersionMismatchError: This worker has another version than the request.
    """
    worker_version = RecognitionRequest().version
    if worker_version != request.version:
        raise VersionMismatchError(
            f"a worker has pointchain {worker_version}, this is {request.version}; install the same there"
        )
    return recognise_file(file, request, path=Path(path))


def dask_setup(_worker: object) -> None:
    """Ignore SIGINT. Dask calls this in each new process of a local cluster, where this module is preloaded.

    Ctrl-C reaches all processes of the terminal; the main process shuts the workers down cleanly.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
