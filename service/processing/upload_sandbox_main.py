"""The process that reads one recording of a stranger: `service.processing.upload_sandbox` starts it and says why.

It imports little, so that it starts quickly, and only then takes its limits upon itself: they are for the file.
"""

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from calibration.geometry.transforms import from_quaternion, rigid
from cell.recording.errors import RecordingError
from cell.recording.reader import read_recording

NICER = 10
"""Than the service: what watches the arm comes first where there are few cores."""
FILES = 16
"""So many it may have open: the recording, its pipe, and what a library may look into."""
RESERVE_BYTES = 4 << 20
"""Set aside, so that a process without memory can still say so."""
MEMORY, UNEXPECTED = "memory", "unexpected"
"""Besides the slugs of RecordingErrors: why there is no answer."""


def main() -> None:
    """Reads the recording that is named on the command line; says on stdout, in JSON, what came of it."""
    path, memory_bytes, cpu_s = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    reserve = [bytes(RESERVE_BYTES)]
    _warm_up()
    _limit(memory_bytes, cpu_s)
    try:
        answer: dict[str, Any] = {"content": describe(Path(path))}
    except RecordingError as error:
        answer = {"error": (error.slug, str(error))}
    except MemoryError:
        reserve.clear()
        answer = {"error": (MEMORY, "")}
    except Exception as error:  # noqa: BLE001 (the reader met what nobody thought of: told to whoever sent it)
        reserve.clear()
        answer = {"error": (UNEXPECTED, type(error).__name__)}
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # nothing is left to be taken apart


def describe(path: Path) -> dict[str, Any]:
    """What the store keeps of the recording, but for what can be told without reading it. Raises RecordingError."""
    recording = read_recording(path)
    header = recording.header
    return {
        "views": len(recording.views),
        "missing": list(recording.missing),
        "string_radius_m": header.string_radius_m,
        "table_z_m": header.table_z_m,
        "provenance": dict(header.provenance),
    }


def _warm_up() -> None:
    """SciPy is imported and the buffers of linear algebra are taken now: they would count as the file's, and a process
    in which they cannot be had ends without a word."""
    rigid(from_quaternion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "pose"), "pose")


def _limit(memory_bytes: int, cpu_s: int) -> None:
    """No file is written, no process and no core file made, and memory and time are bounded."""
    with contextlib.suppress(OSError):
        os.nice(NICER)
    try:
        import resource
    except ImportError:  # not POSIX: whoever started it ends it in time, that is all
        return
    wanted = {
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_NOFILE: FILES,
    }
    if hasattr(resource, "RLIMIT_NPROC"):
        wanted[resource.RLIMIT_NPROC] = 0
    if (present := _address_space()) is not None:
        wanted[resource.RLIMIT_AS] = present + memory_bytes
    for what, most in wanted.items():
        _, hard = resource.getrlimit(what)
        allowed = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (allowed, allowed))
    # The signal that tells why comes at the lower of the two, SIGKILL at the upper.
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if hard == resource.RLIM_INFINITY or hard > cpu_s:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))


def _address_space() -> int | None:
    """What this process has of it, bytes; None where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")
