"""Another process that has the database for itself, as somebody who looks into it by hand."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.storage.data_folder import DATABASE

PROGRAM = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], timeout=60.0, isolation_level=None)
for statement in sys.stdin:
    database.execute(statement)
    print("done", flush=True)
database.close()
"""


class OtherProcess:
    """One that can have the database of a data folder for itself, again and again. To be closed."""

    def __init__(self, data: Path) -> None:
        arguments = [sys.executable, "-c", PROGRAM, str(data / DATABASE)]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)

    @contextmanager
    def locking(self) -> Iterator[None]:
        """Within, it has."""
        self._ask("BEGIN EXCLUSIVE")
        try:
            yield
        finally:
            self._ask("ROLLBACK")

    def close(self) -> None:
        """Ends it."""
        self._process.communicate(timeout=30.0)

    def _ask(self, statement: str) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{statement}\n")
        assert self._process.stdout.readline() == "done\n"
