"""What a worker of a cluster does."""

import signal
from pathlib import Path

from service.batch.recognise_file import Asked, Line, recognise_file


class OtherVersionError(Exception):
    """A worker has another version: its models would be mixed with ours."""


def work_on(file: str, path: str, asked: Asked) -> Line:
    """Recognises the recording at `path`, which is called `file`. Raises OtherVersionError."""
    ours = Asked().version
    if ours != asked.version:
        raise OtherVersionError(f"a worker has pointchain {ours}, this is {asked.version}; install the same there")
    return recognise_file(file, asked, path=Path(path))


def dask_setup(_worker: object) -> None:
    """Called by Dask in each new process of a local cluster, where this module is preloaded.

    Ctrl-C reaches all processes of the terminal; who asked for the work ends the workers in order.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
