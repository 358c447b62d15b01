"""All threads of the service share one heap, so that what one has freed serves the others."""

import platform
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest

from tests.processes import PROC
from tests.service.conftest import wait_until
from tests.service.service_process import ROOT, answers, process

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has these heaps")

HEAP_BYTES = 64 << 20
"""Size and alignment of the address range that glibc reserves for each further heap."""
MAX_KEPT_BYTES = 16 << 20
"""Maximum growth of the process of `FREE_BLOCKS`, whose threads all free blocks of up to 8 MiB."""

FREE_BLOCKS = """
import os, threading
from pathlib import Path
from service.server.heap import share_one_heap

def rss_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def free_blocks():
    for _ in range(3):
        for mib in range(1, 9):
            block = b"x" * (mib << 20)
            kept.append(b"y" * 600)
            del block
    freed.wait()
    measured.wait()

share_one_heap()
kept, before = [], rss_bytes()
freed, measured = threading.Barrier(9), threading.Event()
for _ in range(8):
    threading.Thread(target=free_blocks).start()
freed.wait()
print(rss_bytes() - before)
measured.set()
"""
"""Program whose threads allocate and free blocks. It prints by how many bytes it has grown."""


def growth_bytes() -> int:
    """Return the growth of a process whose threads have freed all large blocks."""
    run = subprocess.run([sys.executable, "-c", FREE_BLOCKS], cwd=ROOT, capture_output=True, text=True, check=True)
    return int(run.stdout)


def test_freed_blocks_are_kept_for_no_thread() -> None:
    assert growth_bytes() < MAX_KEPT_BYTES


def further_heaps(pid: int) -> int:
    """Return the number of glibc's heaps of a process in addition to its main heap."""
    ranges = re.findall(r"^(\w+)-(\w+) (\S+) \S+ 00:00 0 *$", (PROC / f"{pid}/maps").read_text(), re.MULTILINE)
    free_ends = {int(end, 16): int(begin, 16) for begin, end, access in ranges if access == "---p"}
    return sum(
        access == "rw-p"
        and int(begin, 16) % HEAP_BYTES == 0
        and free_ends.get(int(begin, 16) + HEAP_BYTES) == int(end, 16)
        for begin, end, access in ranges
    )


def test_the_threads_of_the_service_share_one_heap(tmp_path: Path) -> None:
    with process(tmp_path / "data", tmp_path / "log") as (running, client):
        wait_until(lambda: answers(client))

        def request(path: str) -> int:
            return httpx2.get(f"{client.base_url}{path}", timeout=60).status_code

        with ThreadPoolExecutor(8) as pool:
            statuses = list(pool.map(request, ["/api/recordings", "/api/scans", "/api/cell", "/metrics"] * 8))
        assert set(statuses) == {200}
        assert further_heaps(running.pid) == 0
