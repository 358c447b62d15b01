"""`pointchain check`: test the cell step by step without motion, and print each result."""

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from cell.self_test.check_result import CheckResult, Outcome
from cell.self_test.self_test import check_cell
from service.config.loader import ConfigError, ServiceConfig, load_config

LOW_FREE_BYTES = 2 << 30
"""Free space below which there is a warning."""
NAME_WIDTH, OUTCOME_WIDTH = 15, 9
COLOURS: dict[Outcome, str] = {"ok": "32", "warning": "33", "failed": "31", "skipped": "90"}


def run_check(config_file: Path | None, as_json: bool) -> int:
    """Test the configured cell. Print each step as it ends, or one JSON document at the end.

    Returns:
        The exit code: 0 if no step failed, else 1.
    """
    steps = []
    for step in _steps(config_file):
        steps.append(step)
        if not as_json:
            print(format_step(step), flush=True)
    passed = all(step.outcome != "failed" for step in steps)
    if as_json:
        print(json.dumps({"passed": passed, "steps": [asdict(step) for step in steps]}, allow_nan=False))
    else:
        print(summarise(steps))
    return 0 if passed else 1


def check_data_folder(config: ServiceConfig) -> CheckResult:
    """Check that the data folder can be written, and that it has the space that the service needs to start a scan.

    The folder is not created.
    """
    name, folder = "data folder", config.data_dir
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        return CheckResult(
            name, "failed", f"{existing} cannot be written", "give it to the service's user, or set data_dir"
        )
    free, needed = shutil.disk_usage(existing).free, config.limits.min_free_bytes
    if free < needed:
        return CheckResult(
            name,
            "failed",
            f"{folder}, {free / 2**20:.0f} MiB free; starting a scan needs {needed / 2**20:.0f} MiB",
            "free some space, set data_dir to another disk, or lower limits.min_free_bytes",
        )
    found = f"{folder}, {free / 2**30:.1f} GiB free"
    if free < LOW_FREE_BYTES:
        advice = "delete recordings, or set data_dir to another disk"
        return CheckResult(name, "warning", f"{found}, which is little", advice)
    return CheckResult(name, "ok", found)


def summarise(steps: Sequence[CheckResult]) -> str:
    """Return one line with the overall result and the number of steps by outcome."""
    counts = {outcome: sum(step.outcome == outcome for step in steps) for outcome in COLOURS}
    if counts["failed"]:
        result = "The cell cannot scan"
    elif counts["skipped"]:
        result = "No step failed, but some were skipped"
    else:
        result = "The cell is ready to scan"
    counted = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
    return f"{result}: {counted}."


def _steps(config_file: Path | None) -> Iterator[CheckResult]:
    try:
        config = load_config(config_file)
    except ConfigError as error:
        yield CheckResult("configuration", "failed", str(error), "correct it; the other steps need it")
        return
    yield from check_cell(config.cell)
    yield check_data_folder(config)


def format_step(step: CheckResult) -> str:
    """Return the text of a step: outcome, name, what was found, and what to do."""
    outcome = f"{step.outcome:{OUTCOME_WIDTH}}"
    if sys.stdout.isatty() and "NO_COLOR" not in os.environ:
        outcome = f"\033[{COLOURS[step.outcome]}m{outcome}\033[0m"
    lines = _wrap(step.message)
    if step.what_to_do is not None:
        lines += [("-> " if k == 0 else "   ") + line for k, line in enumerate(_wrap(step.what_to_do))]
    margin = " " * (OUTCOME_WIDTH + NAME_WIDTH)
    return f"{outcome}{step.name:{NAME_WIDTH}}" + f"\n{margin}".join(lines)


def _wrap(text: str) -> list[str]:
    width = max(shutil.get_terminal_size((120, 24)).columns - OUTCOME_WIDTH - NAME_WIDTH - 3, 40)
    return [line for part in text.splitlines() for line in textwrap.wrap(part, width, break_on_hyphens=False)] or [""]
