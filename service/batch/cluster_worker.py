"""The task that a worker of the Dask cluster runs."""

import signal
from pathlib import Path

from recognition.request import RecognitionRequest
from service.batch.recognise_file import RecordingLine, recognise_file, release


class VersionMismatchError(Exception):
    """A worker has another version, so its models must not be mixed with those of this run."""


def recognise_on_worker(file: str, path: str, request: RecognitionRequest, expected_release: str) -> RecordingLine:
    """Recognise a recording.

    Args:
        file: Name of the recording, for the line.
        path: The file.
        request: How to recognise it.
        expected_release: Version of Pointchain that sends the request.

    Raises:
        VersionMismatchError: This worker has another version.
    """
    if release() != expected_release:
        raise VersionMismatchError(
            f"a worker has pointchain {release()}, this is {expected_release}; install the same there"
        )
    return recognise_file(file, request, path=Path(path))


def dask_setup(_worker: object) -> None:
    """Ignore SIGINT. Dask calls this in each new process of a local cluster, where this module is preloaded.

    Ctrl-C reaches all processes of the terminal; the main process shuts the workers down cleanly.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
