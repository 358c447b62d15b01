"""The reference of the command line has every command and every argument of the program."""

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from service.cli.main import _parser
from tests.docs.pages import DOCS, ROOT

INDEX = DOCS / "reference/command-line.md"
PAGES = sorted((DOCS / "reference/command-line").glob("*.md"))
ALL_TEXT = "".join(page.read_text() for page in PAGES)


def leaves(
    parser: argparse.ArgumentParser, path: tuple[str, ...] = ()
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the name, such as `calibrate run`, and the parser of each command without subcommands."""
    (below,) = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)] or [None]
    if below is None:
        yield " ".join(path), parser
        return
    for name, command in below.choices.items():
        yield from leaves(command, (*path, name))


COMMANDS = dict(leaves(_parser()))


def section(name: str) -> str:
    """Return the text below the heading of a command."""
    (found,) = re.findall(rf"^##+ {re.escape(name)}\n(.*?)(?=^##? |^###|\Z)", ALL_TEXT, re.MULTILINE | re.DOTALL)
    return found


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_lists_all_its_arguments(name: str) -> None:
    shown = section(name)
    # The usage text comes from argparse, which is independent of our generator.
    options = set(re.findall(r"(?<![\w-])--[a-z-]+", COMMANDS[name].format_usage())) - {"--help"}
    assert {option for option in options if f"`{option}" not in shown} == set()
    assert f"pointchain {name}" in shown
    assert options == set(re.findall(r"^\| `(--[a-z-]+)", shown, re.MULTILINE))


def test_no_hidden_argument_is_shown() -> None:
    assert "--supervised" not in ALL_TEXT


@pytest.mark.parametrize("columns", ["40", "200"])
def test_the_pages_do_not_depend_on_the_terminal_width(columns: str) -> None:
    program = "import json; from generated.command_line import pages; print(json.dumps(pages()))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT / "docs",
        env={"COLUMNS": columns, "PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == {str(page.relative_to(DOCS)): page.read_text() for page in [INDEX, *PAGES]}
