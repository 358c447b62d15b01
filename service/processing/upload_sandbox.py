"""A recording that somebody sent, read in a process of its own with little of everything.

The reader checks each size before it trusts it. This is for what it may have missed, and for the libraries below it: a
file that makes them take all memory, never end, or crash, takes a process with it that does nothing else. A process
for each file, so that none leaves anything behind for the next; starting one takes about half a second.
"""

import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import MCAP0_MAGIC

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
MOST_ANSWER_BYTES = 4 * MIB
"""Far more than there is to tell of any recording."""
PROGRAM = "from service.processing.upload_sandbox_main import main; main()"

KNOWN: dict[str, type[RecordingError]] = {
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


class RecordingRefusedError(RecordingError):
    """Reading it was ended: it took too much, or crashed the reader."""

    slug = "recording-refused"


@dataclass(frozen=True)
class ChildLimits:
    """What reading one recording may take."""

    memory_bytes: int = 160 * MIB
    """Address space beyond what the process has before it opens the file, which is 90 MiB of memory. 64 views of
    1280x800 take 150 MiB."""
    cpu_s: int = 20
    """Time on a core, starting included."""
    wall_s: float = 60.0
    """In all. More than `cpu_s`, for a busy machine."""


DEFAULT_CHILD_LIMITS = ChildLimits()


def describe_foreign_recording(
    recording_id: str, path: Path, sha256: str, limits: ChildLimits = DEFAULT_CHILD_LIMITS
) -> RecordingRow:
    """The row of a recording that may hold anything, as `describe_recording` gives it.

    Raises:
        RecordingError: it cannot be used; RecordingRefusedError names the limit that it met.
        OSError: the file cannot be opened.
    """
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            upload_sandbox_main.describe(path)  # refuses it by that, and reads no more of it
    code, said = _ask(path, limits)
    if code is None:
        raise RecordingRefusedError(f"{path.name} was not read within {limits.wall_s:g} s")
    if code != 0:
        raise RecordingRefusedError(_ended(path.name, code, limits))
    try:
        answer = json.loads(said)
        if "error" in answer:
            slug, words = answer["error"]
            raise _error(path.name, slug, words, limits)
        size_bytes = path.stat().st_size
        return RecordingRow(
            id=recording_id, created_at=now(), size_bytes=size_bytes, sha256=sha256, **answer["content"]
        )
    except RecordingError:
        raise
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingRefusedError(f"reading {path.name} gave no sensible answer") from error


def _error(name: str, slug: str, words: str, limits: ChildLimits) -> RecordingError:
    """What the process says it was that it met."""
    if slug in KNOWN:
        return KNOWN[slug](words)
    if slug == upload_sandbox_main.MEMORY:
        return RecordingRefusedError(f"reading {name} took more than {limits.memory_bytes // MIB} MiB of memory")
    return RecordingRefusedError(f"reading {name} met an unexpected {words}: it is damaged, or made to do so")


def _ended(name: str, code: int, limits: ChildLimits) -> str:
    """In words, why the process gave no answer."""
    if code == -signal.SIGXCPU:
        return f"reading {name} took more than {limits.cpu_s} s on a core"
    return f"reading {name} crashed the reader (exit code {code}): it is damaged, or made to do so"


def _ask(path: Path, limits: ChildLimits) -> tuple[int | None, bytes]:
    """The process's exit code and what it said; None instead of the code when its time was over."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", PROGRAM, str(path.absolute()), str(limits.memory_bytes), str(limits.cpu_s)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # what a library says of a stranger's file is not for our log
        cwd="/",
        env=_environment(),
        start_new_session=True,
    )
    late = threading.Event()

    def end() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(limits.wall_s, end)
    timer.daemon = True
    try:
        timer.start()
        with process:
            assert process.stdout is not None
            said = process.stdout.read(MOST_ANSWER_BYTES + 1)
            if len(said) > MOST_ANSWER_BYTES:
                process.kill()
            code = process.wait()
    finally:
        timer.cancel()
        process.kill()
    return (None if late.is_set() else code), said


def _environment() -> dict[str, str]:
    """Nothing of the service's own, which may hold what no stranger's file should come near."""
    return {
        "PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in sys.path),
        "OPENBLAS_NUM_THREADS": "1",  # its threads' stacks would count
        "MALLOC_ARENA_MAX": "1",
        "MALLOC_MMAP_THRESHOLD_": "262144",  # images are given back at once, not kept in pieces
    }
