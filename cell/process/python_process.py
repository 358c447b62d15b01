"""Start and end of Python child processes, which end with their parent."""

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.connection import wait
from pathlib import Path
from typing import IO

STDIN = 0
"""File descriptor of the standard input, which the parent holds open with `stdin=subprocess.PIPE`."""
PARENT_CHECK_S = 1.0
"""Interval at which a child checks its parent's process id."""


def start_python(
    *arguments: str,
    environment: Mapping[str, str] | None = None,
    cwd: str | Path | None = None,
    stdin: int | None = None,
    stdout: int | IO[bytes] | None = None,
    stderr: int | IO[bytes] | None = None,
    pass_fds: Sequence[int] = (),
) -> "subprocess.Popen[bytes]":
    """Start a Python process that imports the same modules as this one. End it with `end_process`.

    It has a session of its own, so that Ctrl-C at a terminal reaches only this process.

    Args:
        *arguments: Arguments of the interpreter, such as `-m` and a module, or `-c` and a program.
        environment: Environment variables besides PYTHONPATH. None: those of this process.
        cwd: Working folder of the process. None: that of this process.
        stdin: As for `subprocess.Popen`, like all that follow. A process that calls `exit_with_parent` needs a pipe.
        stdout: Standard output.
        stderr: Standard error.
        pass_fds: File descriptors that the process inherits.

    Raises:
        OSError: The process cannot be started.
    """
    paths = os.pathsep.join(str(Path(path).absolute()) for path in sys.path)
    return subprocess.Popen(
        [sys.executable, "-P", *arguments],  # nothing is imported from the current folder
        env={**(os.environ if environment is None else environment), "PYTHONPATH": paths},
        start_new_session=True,
        cwd=cwd,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        pass_fds=pass_fds,
    )


def end_process(process: "subprocess.Popen[bytes]", wait_s: float = 0.0, terminate: bool = False) -> int:
    """End a process, and return its exit code. No zombie process and no open pipe remain.

    Args:
        process: The process. It may have ended already.
        wait_s: Time for the process to end by itself. It is killed after that.
        terminate: Whether SIGTERM asks the process to end.
    """
    if terminate:
        process.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(wait_s)
    process.kill()
    code = process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
    return code


def exit_with_parent(pipe: int = STDIN) -> None:
    """Let this process exit with code 1 when its parent has ended, however that ended. Starts a thread.

    Args:
        pipe: File descriptor of a pipe whose other end only the parent holds, and to which it writes nothing: the
            standard input, or the sentinel of `multiprocessing.parent_process`.
    """
    # The pipe stays open while a fork of the parent lives, so that the parent's id is checked too.
    threading.Thread(target=_wait_for_parent, args=(pipe, os.getppid()), name="parent", daemon=True).start()


def _wait_for_parent(pipe: int, parent_pid: int) -> None:
    while os.getppid() == parent_pid and not wait([pipe], PARENT_CHECK_S):
        pass
    os._exit(1)
