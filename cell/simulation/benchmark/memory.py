"""Resident memory of this process."""

import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def peak_rss_bytes() -> int:
    """The most that was ever resident."""
    told = _status("VmHWM")
    if told is not None:
        return told
    # Where there is no better: on Linux this counts what the process was forked from, too.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Kilobytes, but bytes on macOS.
    return peak if sys.platform == "darwin" else peak * 1024


def current_rss_bytes() -> int:
    """What is resident now; where the system does not tell, the most that ever was."""
    told = _status("VmRSS")
    return peak_rss_bytes() if told is None else told


def _status(name: str) -> int | None:
    """A size from what Linux tells of the process, None where it does not."""
    if not _STATUS.exists():
        return None
    sizes = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines() if ":" in line)
    return int(sizes[name].split()[0]) * 1024 if name in sizes else None
