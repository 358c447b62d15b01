"""Read the resident memory (RSS) of this process."""

import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def peak_rss_bytes() -> int:
    """Return the peak resident memory of this process so far, bytes."""
    size = _read_status("VmHWM")
    if size is not None:
        return size
    # `ru_maxrss` is the fallback only, because on Linux it includes the memory of the parent process before `exec`.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # The unit of `ru_maxrss` is kilobytes, but bytes on macOS.
    return peak if sys.platform == "darwin" else peak * 1024


def current_rss_bytes() -> int:
    """Return the current resident memory, bytes, or the peak if the system does not report the current value."""
    size = _read_status("VmRSS")
    return peak_rss_bytes() if size is None else size


def _read_status(name: str) -> int | None:
    """Return a size from `/proc/self/status`, bytes, or None if the system does not report it."""
    if not _STATUS.exists():
        return None
    sizes = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines() if ":" in line)
    return int(sizes[name].split()[0]) * 1024 if name in sizes else None
