"""Read an untrusted recording in a sandbox: its own process, with limits on memory, time and files.

The reader checks each size before it trusts it. The sandbox covers checks that the reader lacks, and the libraries
that it uses: a file that exhausts the memory, never ends or crashes affects only this process. Each file has a new
process, so that no file affects the next one. The start of a process takes about half a second.
"""

import json
import signal
import subprocess
import threading
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import MCAP0_MAGIC

from cell.process.python_process import end_process, start_python
from cell.recording.errors import (
    NotMcapError,
    RecordingContentError,
    RecordingCorruptError,
    RecordingEmptyError,
    RecordingError,
    RecordingHeaderError,
    RecordingTooLargeError,
    RecordingUnreadableError,
)
from service.processing import upload_sandbox_main
from service.storage.database import now
from service.storage.rows import RecordingRow

MIB = 1 << 20
MAX_OUTPUT_BYTES = 4 * MIB
"""Maximum size of the process's output, far more than any recording needs."""
PROGRAM = "from service.processing.upload_sandbox_main import main; main()"
"""Python code that the process runs."""
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",  # the stacks of its threads would count as memory of the file
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": "262144",  # freed images return to the system at once, without fragments
}
"""Environment of the process. It has none of the service's variables, since they may hold secrets."""

ERRORS_BY_SLUG: dict[str, type[RecordingError]] = {
    kind.slug: kind
    for kind in (
        NotMcapError,
        RecordingContentError,
        RecordingCorruptError,
        RecordingEmptyError,
        RecordingHeaderError,
        RecordingTooLargeError,
        RecordingUnreadableError,
    )
}
"""Errors that the process reports by their slug."""


class RecordingRefusedError(RecordingError):
    """Reading the recording was stopped: it took too much time or memory, or crashed the reader."""

    slug = "recording-refused"


@dataclass(frozen=True)
class SandboxLimits:
    """Limits for reading one recording."""

    memory_bytes: int = 224 * MIB
    """Address space in addition to that of the process before it opens the file, bytes.

    The process has 90 MiB of memory by then. 64 views of 1280x800 with intensity images take 205 MiB.
    """
    cpu_s: int = 20
    """CPU time including the start of the process, seconds."""
    wall_s: float = 60.0
    """Total time, seconds. It exceeds `cpu_s`, for a busy machine."""


DEFAULT_LIMITS = SandboxLimits()


def describe_untrusted_recording(
    recording_id: str, path: Path, sha256: str, limits: SandboxLimits = DEFAULT_LIMITS
) -> RecordingRow:
    """Return the database row of a recording that may have any content, like `describe_recording`.

    Args:
        recording_id: Id of the recording.
        path: The recording.
        sha256: SHA-256 of the file.
        limits: Limits of the process.

    Raises:
        RecordingError: The recording cannot be used. RecordingRefusedError names the exceeded limit.
        OSError: The file cannot be opened.
    """
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            upload_sandbox_main.describe(path)  # raises NotMcapError after these bytes, without a process
    code, output = _run_reader(path, limits)
    if code is None:
        raise RecordingRefusedError(f"{path.name} was not read within {limits.wall_s:g} s")
    if code != 0:
        raise RecordingRefusedError(_exit_message(path.name, code, limits))
    try:
        answer = json.loads(output)
        if "error" in answer:
            slug, message = answer["error"]
            raise _reported_error(path.name, slug, message, limits)
        size_bytes = path.stat().st_size
        return RecordingRow(
            id=recording_id, created_at=now(), size_bytes=size_bytes, sha256=sha256, **answer["content"]
        )
    except RecordingError:
        raise
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingRefusedError(
            f"the reader gave no valid output for {path.name}: use another recording"
        ) from error


def _reported_error(name: str, slug: str, message: str, limits: SandboxLimits) -> RecordingError:
    """Return the error that the process reported."""
    if slug in ERRORS_BY_SLUG:
        return ERRORS_BY_SLUG[slug](message)
    if slug == upload_sandbox_main.MEMORY:
        return RecordingRefusedError(f"reading {name} took more than {limits.memory_bytes // MIB} MiB of memory")
    return RecordingRefusedError(f"reading {name} failed with an unexpected {message}: the file is damaged or hostile")


def _exit_message(name: str, code: int, limits: SandboxLimits) -> str:
    """Return a message about a process that ended without output."""
    if code == -signal.SIGXCPU:
        return f"reading {name} took more than {limits.cpu_s} s of CPU time"
    return f"reading {name} crashed the reader (exit code {code}): the file is damaged or hostile"


def _run_reader(path: Path, limits: SandboxLimits) -> tuple[int | None, bytes]:
    """Run the process and return its exit code, or None after a timeout, and its output."""
    arguments = (str(path.absolute()), str(limits.memory_bytes), str(limits.cpu_s))
    process = start_python(
        "-c",
        PROGRAM,
        *arguments,
        environment=ENVIRONMENT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # messages of libraries about an untrusted file stay out of the log
        cwd="/",
    )
    timed_out = threading.Event()

    def kill_at_timeout() -> None:
        timed_out.set()
        process.kill()

    timer = threading.Timer(limits.wall_s, kill_at_timeout)
    timer.daemon = True
    try:
        timer.start()
        assert process.stdout is not None
        output = process.stdout.read(MAX_OUTPUT_BYTES + 1)
        code = end_process(process, limits.wall_s if len(output) <= MAX_OUTPUT_BYTES else 0.0)
    finally:
        timer.cancel()
        end_process(process)
    return (None if timed_out.is_set() else code), output
