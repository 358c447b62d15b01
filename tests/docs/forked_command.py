"""`pointchain` commands in forked processes, which have the libraries loaded already.

Loading them takes more than half of the time of most commands.
"""

import os
import re
import shlex
import sys
from collections.abc import Mapping
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from service.cli.main import main

_COMMAND = re.compile(r"(?P<variables>(?:\w+=[\w./-]+ )*)pointchain (?P<arguments>[^|&;<>$*?~`()]+)(?:> (?P<out>\S+))?")
TIMEOUT_S = 200.0
"""Time limit of a command, which only bounds a hang."""


def run_forked(command: str, folder: Path, environment: Mapping[str, str]) -> tuple[int | None, str] | None:
    """Run a command in `folder`.

    Args:
        command: One line for a shell.
        folder: Working folder.
        environment: Environment variables.

    Returns:
        The exit code, None after a timeout, and what was printed. None if the command needs a shell: it is more than
        one call of `pointchain` with variables before it and a file for its standard output.
    """
    found = _COMMAND.fullmatch(command)
    if found is None:
        return None
    variables = dict(word.split("=", 1) for word in found["variables"].split())
    with TemporaryDirectory() as logs:
        log = Path(logs, "log")
        out = log if found["out"] is None else folder / found["out"]
        arguments = (shlex.split(found["arguments"]), folder, {**environment, **variables}, out, log)
        process = get_context("forkserver").Process(target=_run, args=arguments)
        process.start()
        process.join(TIMEOUT_S)
        code = process.exitcode
        process.kill()
        process.join()
        process.close()
        return code, log.read_text()


def _run(arguments: list[str], folder: Path, environment: Mapping[str, str], out: Path, log: Path) -> None:
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for descriptor, path in ((1, out), (2, log)):
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_TRUNC, 0o644)
        os.dup2(opened, descriptor)
        os.close(opened)
    sys.argv = ["pointchain", *arguments]
    sys.exit(main(arguments))
