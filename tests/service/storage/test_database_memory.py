"""Many connections to a large database keep little of it in memory."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.processes import PROC
from tests.service.service_process import ROOT

MAX_GROWTH_BYTES = 32 << 20
"""Maximum growth by 40 connections. With SQLite's default each would keep 2 MB."""

READ_BY_MANY = """
import os, sys
from contextlib import ExitStack, closing
from pathlib import Path
from service.storage.database import Database

def rss_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

with closing(Database(Path(sys.argv[1]))) as database, ExitStack() as used:
    with database.transaction() as db:
        db.execute("CREATE TABLE large (content TEXT)")
        db.executemany("INSERT INTO large VALUES (?)", [["x" * 1000]] * 4000)
    before = rss_bytes()
    for _ in range(40):
        db = used.enter_context(database.connection())
        db.execute("SELECT max(content) FROM large").fetchone()
    print(rss_bytes() - before)
"""
"""Program that reads a table by 40 connections at the same time, and prints by how many bytes it has grown."""


@pytest.mark.skipif(not PROC.is_dir(), reason="the system has no /proc")
def test_many_connections_keep_few_pages(tmp_path: Path) -> None:
    command = [sys.executable, "-c", READ_BY_MANY, str(tmp_path / "store.db")]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(run.stdout) < MAX_GROWTH_BYTES
