"""Another process that locks the database, as a person does who inspects it by hand."""

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
    """A process that can lock the database of a data folder repeatedly. It must be closed."""

    def __init__(self, data: Path) -> None:
        arguments = [sys.executable, "-c", PROGRAM, str(data / DATABASE)]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)

    @contextmanager
    def locking(self) -> Iterator[None]:
        """Lock the database exclusively during the body."""
        self._execute("BEGIN EXCLUSIVE")
        try:
            yield
        finally:
            self._execute("ROLLBACK")

    def close(self) -> None:
        """End the process."""
        self._process.communicate(timeout=30.0)

    def _execute(self, statement: str) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{statement}\n")
        assert self._process.stdout.readline() == "done\n"
