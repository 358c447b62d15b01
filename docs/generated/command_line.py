"""Generate the pages of the command line from the parser of `pointchain`.

The text is laid out here and not by argparse, whose layout depends on the terminal and on the version of Python.
"""

import argparse
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from service.cli.main import _parser

WIDTH = 100
"""Columns of a usage line."""

INTRODUCTION = """\
# Command line

This page lists every command of the program `pointchain`. The page behind each link has its arguments. The pages are
generated from the program itself; `pointchain COMMAND --help` prints the same.

- After `make setup`, the program is `.venv/bin/pointchain`.
- Results go to stdout. Progress, questions and error messages go to stderr.
- Exit codes: 0 for success, 1 for a failure, 2 for wrong arguments, 130 after Ctrl-C. Where a command uses them
  differently, its section says so.
- Ctrl-C and SIGTERM stop the arm at once in `scan`, `calibrate run`, `calibrate verify` and `serve`. Views that were
  recorded until then are kept. `serve` then exits with code 0.
- Without `--config`, the commands use the file that the variable `POINTCHAIN_CONFIG` names, or the defaults, which
  describe the simulated cell. See [Configuration](../integrator/configuration.md).
- Lengths are in metres. The value in parentheses after a description is the default.
"""

INTRODUCTION_OF_PAGE = """\
# {title}

This page has the arguments of the commands that {subject}.
[Command line](../command-line.md) lists all commands, and explains exit codes and the configuration file.
"""

EXPLAINED = {
    "audit": ("Security", "../../integrator/security.md"),
    "bench": ("Benchmarks", "../../researcher/benchmarks.md"),
    "calibrate": ("Calibrate the camera", "../../integrator/calibration.md"),
    "camera-profile": ("Depth quality of the camera", "../../integrator/depth-camera.md"),
    "check": ("Commission a cell", "../../integrator/commissioning.md"),
    "compare": ("Many recordings", "../../researcher/batch.md"),
    "demo": ("Tutorial", "../../tutorial.md"),
    "doctor": ("Operate the service", "../../integrator/operation.md"),
    "export": ("Recordings", "../../researcher/recordings.md"),
    "import": ("Your own data", "../../researcher/own-data.md"),
    "import bag": ("Import ROS bags", "../../integrator/ros-bags.md"),
    "openapi": ("HTTP interface", "../../planner/http.md"),
    "recognise": ("Many recordings", "../../researcher/batch.md"),
    "scan": ("Commission a cell", "../../integrator/commissioning.md"),
    "serve": ("Operate the service", "../../integrator/operation.md"),
    "simulate": ("Simulated scenes", "../../researcher/simulated-scenes.md"),
    "token": ("Security", "../../integrator/security.md"),
    "viewpoints": ("Commission a cell", "../../integrator/commissioning.md"),
}
"""The page that explains each command."""


@dataclass(frozen=True)
class Page:
    """A page on some commands."""

    title: str
    """Title of the page."""
    subject: str
    """What its commands do."""
    commands: tuple[str, ...]
    """Names of its commands, in the order of the page."""


PAGES = {
    "cell": Page(
        "Commands for the cell",
        "check, calibrate and use the configured cell",
        ("calibrate", "check", "demo", "scan", "viewpoints"),
    ),
    "recordings": Page(
        "Commands for recordings",
        "make, import, recognise, compare and export recordings",
        ("bench", "camera-profile", "compare", "export", "import", "recognise", "simulate"),
    ),
    "service": Page(
        "Commands for the service",
        "run the service, and give access to it",
        ("audit", "doctor", "openapi", "serve", "token"),
    ),
}
"""The pages below `reference/command-line/`, by file name."""


def pages() -> dict[str, str]:
    """Return the pages as Markdown, by their path below `docs/`."""
    parser = _parser()
    written = {"reference/command-line.md": _index(parser)}
    for name, page in PAGES.items():
        written[f"reference/command-line/{name}.md"] = _page(page, commands(parser))
    return written


def _index(parser: argparse.ArgumentParser) -> str:
    toctree = ["```{toctree}", ":hidden:", "", *(f"command-line/{name}" for name in PAGES), "```"]
    return "\n".join([INTRODUCTION, _overview(parser), *toctree, ""])


def _page(page: Page, all_commands: Mapping[str, argparse.ArgumentParser]) -> str:
    parts = [INTRODUCTION_OF_PAGE.format(title=page.title, subject=page.subject)]
    for name in page.commands:
        command = all_commands[name]
        parts.append(_section("##", name, command, _see_also(name)))
        for sub, below in sorted(commands(command).items()):
            path = f"{name} {sub}"
            parts.append(_section("###", path, below, _see_also(path) if path in EXPLAINED else ""))
    return "\n".join(parts)


def _see_also(name: str) -> str:
    label, target = EXPLAINED[name]
    return f"\nSee also: [{label}]({target}).\n"


def commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the commands of a parser by name; none for a parser without commands."""
    action = _subparsers(parser)
    return {} if action is None else dict(action.choices)


def _overview(parser: argparse.ArgumentParser) -> str:
    helps = _helps(parser)
    page_of = {command: name for name, page in PAGES.items() for command in page.commands}
    rows = [f"| [`{name}`](command-line/{page_of[name]}.md#{name}) | {_cell(helps[name])} |" for name in sorted(helps)]
    return "\n".join(["| command | what it does |", "|---|---|", *rows]) + "\n"


def _section(level: str, name: str, parser: argparse.ArgumentParser, more: str = "") -> str:
    parts = [f"{level} {name}\n"]
    if parser.description:
        parts.append(f"{textwrap.fill(_code(parser.description), 120)}\n")
    helps = _helps(parser)
    if helps:
        parts.append("\n".join(f"- [`{sub}`](#{name}-{sub}): {helps[sub]}" for sub in sorted(helps)) + "\n")
    else:
        parts.append(f"```text\n{usage(f'pointchain {name}', parser)}\n```\n")
    rows = [f"| {_cell(_spelled(action))} | {_cell(_meaning(action, parser))} |" for action in _arguments(parser)]
    if rows:
        parts.append("\n".join(["| argument | meaning |", "|---|---|", *rows]) + "\n")
    return "\n".join(parts) + more


def usage(program: str, parser: argparse.ArgumentParser) -> str:
    """Return the usage lines of a command."""
    optional = [action for action in _arguments(parser) if action.option_strings]
    positional = [action for action in _arguments(parser) if not action.option_strings]
    words = [_usage_word(action) for action in (*positional, *optional)]
    # An argument and its value stay on one line.
    glued = " ".join([program.replace(" ", "\0"), *(word.replace(" ", "\0") for word in words)])
    wrapped = textwrap.fill(glued, WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    return wrapped.replace("\0", " ")


def _arguments(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        hidden = action.help == argparse.SUPPRESS
        if not hidden and not isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
            yield action


def _usage_word(action: argparse.Action) -> str:
    values = _values(action)
    if not action.option_strings:
        return values
    word = action.option_strings[-1] + (f" {values}" if values else "")
    return word if action.required else f"[{word}]"


def _values(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    if isinstance(action.metavar, tuple):
        return " ".join(action.metavar)
    name = str(action.metavar or action.dest.upper()) if action.choices is None else "|".join(map(str, action.choices))
    match action.nargs:
        case None:
            return name
        case "?":
            return f"[{name}]"
        case "+":
            return f"{name}..."
        case "*":
            return f"[{name}...]"
        case count:
            return " ".join([name] * int(count))


def _spelled(action: argparse.Action) -> str:
    values = _values(action)
    if not action.option_strings:
        return f"`{values.strip('[]')}`"
    return f"`{action.option_strings[-1]}{f' {values}' if values else ''}`"


def _meaning(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    text = _code((action.help or "") % {"default": action.default})
    if isinstance(action, argparse._AppendAction) and "repeat" not in text:
        text += "; can be repeated"
    for group in parser._mutually_exclusive_groups:
        if action in group._group_actions:
            others = (f"`{other.option_strings[-1]}`" for other in group._group_actions if other is not action)
            text += f"; not together with {' or '.join(others)}"
    return text


def _helps(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Return the one-line help of each command of a parser."""
    action = _subparsers(parser)
    return {} if action is None else {choice.dest: _code(choice.help or "") for choice in action._choices_actions}


def _subparsers(parser: argparse.ArgumentParser) -> "argparse._SubParsersAction[argparse.ArgumentParser] | None":
    return next((action for action in parser._actions if isinstance(action, argparse._SubParsersAction)), None)


def _code(text: str) -> str:
    """Return a text on one line, with its options in code font: two hyphens would become a dash."""
    return re.sub(r"(?<![\w`-])(--[a-z-]+)", r"`\1`", " ".join(text.split()))


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
