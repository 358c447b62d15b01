"""`pointchain check`: the whole cell tested step by step without motion, told as it goes."""

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

LEAST_FREE_BYTES = 200 << 20
"""With less, not even one scan is sure to fit: recordings are taken up to 160 MB."""
LITTLE_FREE_BYTES = 2 << 30
NAME_WIDTH, OUTCOME_WIDTH = 15, 9
COLOURS: dict[Outcome, str] = {"ok": "32", "warning": "33", "failed": "31", "skipped": "90"}


def check(config_file: Path | None, as_json: bool) -> int:
    """Tests the cell of the configuration; 0 when no step failed, else 1.

    For people, a step is printed when it is done; for programs, one JSON document at the end.
    """
    steps = []
    for step in _steps(config_file):
        steps.append(step)
        if not as_json:
            print(told_step(step), flush=True)
    passed = all(step.outcome != "failed" for step in steps)
    if as_json:
        print(json.dumps({"passed": passed, "steps": [asdict(step) for step in steps]}, allow_nan=False))
    else:
        print(verdict(steps))
    return 0 if passed else 1


def data_folder(config: ServiceConfig) -> CheckResult:
    """Recordings and results can be written, and there is room for them."""
    name, folder = "data folder", config.data_dir
    place = next(place for place in (folder, *folder.parents) if place.exists())
    if not place.is_dir() or not os.access(place, os.W_OK):
        return CheckResult(
            name, "failed", f"{place} cannot be written", "give it to the service's user, or set data_dir"
        )
    free = shutil.disk_usage(place).free
    words = f"{folder}, {free / 2**30:.1f} GiB free"
    if free < LEAST_FREE_BYTES:
        return CheckResult(name, "failed", words, "free some space, or set data_dir to another disk")
    if free < LITTLE_FREE_BYTES:
        return CheckResult(
            name, "warning", words + ": that is little", "delete recordings, or set data_dir to another disk"
        )
    return CheckResult(name, "ok", words)


def verdict(steps: Sequence[CheckResult]) -> str:
    """All steps in one line."""
    counts = {outcome: sum(step.outcome == outcome for step in steps) for outcome in COLOURS}
    if counts["failed"]:
        told = "The cell cannot scan"
    elif counts["skipped"]:
        told = "Nothing that was tested keeps the cell from scanning"
    else:
        told = "The cell is ready to scan"
    counted = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
    return f"{told}: {counted}."


def _steps(config_file: Path | None) -> Iterator[CheckResult]:
    try:
        config = load_config(config_file)
    except ConfigError as error:
        yield CheckResult("configuration", "failed", str(error), "correct it: without it nothing else can be tested")
        return
    yield from check_cell(config.cell)
    yield data_folder(config)


def told_step(step: CheckResult) -> str:
    """A step for people: how it went, what it was, in words, and what to do."""
    outcome = f"{step.outcome:{OUTCOME_WIDTH}}"
    if sys.stdout.isatty() and "NO_COLOR" not in os.environ:
        outcome = f"\033[{COLOURS[step.outcome]}m{outcome}\033[0m"
    lines = _wrapped(step.words)
    if step.what_to_do is not None:
        lines += [("-> " if k == 0 else "   ") + line for k, line in enumerate(_wrapped(step.what_to_do))]
    margin = " " * (OUTCOME_WIDTH + NAME_WIDTH)
    return f"{outcome}{step.name:{NAME_WIDTH}}" + f"\n{margin}".join(lines)


def _wrapped(words: str) -> list[str]:
    width = max(shutil.get_terminal_size((120, 24)).columns - OUTCOME_WIDTH - NAME_WIDTH - 3, 40)
    return [line for part in words.splitlines() for line in textwrap.wrap(part, width, break_on_hyphens=False)] or [""]
