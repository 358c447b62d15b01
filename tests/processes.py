"""What the system tells of processes, for tests that end some and look at what is left behind."""

import os
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")


def state(pid: int) -> str:
    """As "S", or "Z" of a zombie; empty when there is no such process, "?" where the system has no /proc."""
    try:
        os.kill(pid, 0)
        return (PROC / f"{pid}/stat").read_text().rpartition(") ")[2][0]
    except (FileNotFoundError, ProcessLookupError) as gone:
        return "?" if isinstance(gone, FileNotFoundError) and not PROC.is_dir() else ""


def runs(pid: int) -> bool:
    """Not when it has ended but nobody has asked how: containers often have no process that does."""
    return state(pid) not in ("", "Z")


def children(pid: int) -> set[int]:
    """What its threads have started and not asked about since, zombies too; none when it is gone."""
    found: set[int] = set()
    with suppress(FileNotFoundError, ProcessLookupError):
        for task in (PROC / f"{pid}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # this thread has ended
                found |= {int(child) for child in (task / "children").read_text().split()}
    return found


def rss_bytes(pid: int) -> int:
    """Resident memory."""
    pages = int((PROC / f"{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
