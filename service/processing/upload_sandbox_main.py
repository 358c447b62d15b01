"""The process that reads one untrusted recording. `service.processing.upload_sandbox` starts it and has the reasons.

It imports little, so that it starts quickly. It sets its limits after the imports, because they are for the file.
"""

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from calibration.geometry.transforms import from_quaternion, rigid
from cell.process.python_process import exit_with_parent
from cell.recording.errors import RecordingError
from cell.recording.reader import read_recording

NICE_INCREMENT = 10
"""Increment of the process's nice value, so that the service, which monitors the arm, has priority on few cores."""
MAX_OPEN_FILES = 16
"""Maximum number of open files: the recording, the pipe, and files that a library may read."""
RESERVE_BYTES = 4 << 20
"""Memory that is set aside, so that a process that is out of memory can still report it."""
MEMORY, UNEXPECTED = "memory", "unexpected"
"""Reasons for a missing result, besides the slugs of RecordingErrors."""


def main() -> None:
    """Read the recording named on the command line and write the result to stdout as JSON."""
    exit_with_parent()
    path, memory_bytes, cpu_s = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    reserve = [bytes(RESERVE_BYTES)]
    _warm_up()
    _set_limits(memory_bytes, cpu_s)
    try:
        answer: dict[str, Any] = {"content": describe(Path(path))}
    except RecordingError as error:
        answer = {"error": (error.slug, str(error))}
    except MemoryError:
        reserve.clear()
        answer = {"error": (MEMORY, "")}
    except Exception as error:  # noqa: BLE001 (the client gets an answer for every error of the reader)
        reserve.clear()
        answer = {"error": (UNEXPECTED, type(error).__name__)}
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # skip the interpreter's shutdown, since nothing needs it


def describe(path: Path) -> dict[str, Any]:
    """Return the members of the recording's database row that come from the content of the file.

    Raises:
        RecordingError: The recording cannot be used.
    """
    recording = read_recording(path)
    header = recording.header
    return {
        "views": len(recording.views),
        "missing": list(recording.missing),
        "string_radius_m": header.string_radius_m,
        "table_z_m": header.table_z_m,
        "provenance": dict(header.provenance),
        "simulated": header.simulated,
    }


def _warm_up() -> None:
    """Import SciPy and allocate the buffers of linear algebra before the limits are set.

    Their memory would count as the file's. A process that cannot allocate the buffers ends without a message.
    """
    rigid(from_quaternion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "pose"), "pose")


def _set_limits(memory_bytes: int, cpu_s: int) -> None:
    """Limit memory and CPU time, and forbid written files, child processes and core files."""
    with contextlib.suppress(OSError):
        os.nice(NICE_INCREMENT)
    try:
        import resource
    except ImportError:  # not POSIX: only the time limit of the parent process applies
        return
    limits = {
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NOFILE: MAX_OPEN_FILES,
    }
    if hasattr(resource, "RLIMIT_NPROC"):
        limits[resource.RLIMIT_NPROC] = 0
    if (present := _address_space_bytes()) is not None:
        limits[resource.RLIMIT_AS] = present + memory_bytes
    for kind, limit in limits.items():
        _, hard = resource.getrlimit(kind)
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (allowed, allowed))
    # SIGXCPU, which names the reason, comes at the soft limit, and SIGKILL at the hard limit
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if hard == resource.RLIM_INFINITY or hard > cpu_s:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))


def _address_space_bytes() -> int | None:
    """Return the size of this process's address space, or None where the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")
