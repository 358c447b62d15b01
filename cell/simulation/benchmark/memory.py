"""Read the resident memory of this process."""

import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def peak_rss_bytes() -> int:
    """Return the peak resident memory of this process so far."""
    size = _status("VmHWM")
    if size is not None:
        return size
    # The fallback: on Linux it includes the memory of the process that this one was forked from.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Kilobytes, but bytes on macOS.
    return peak if sys.platform == "darwin" else peak * 1024


def current_rss_bytes() -> int:
    """Return the resident memory now; the peak where the system does not report it."""
    size = _status("VmRSS")
    return peak_rss_bytes() if size is None else size


def _status(name: str) -> int | None:
    """Return a size in the status that Linux reports of the process; None elsewhere."""
    if not _STATUS.exists():
        return None
    sizes = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines() if ":" in line)
    return int(sizes[name].split()[0]) * 1024 if name in sizes else None
