"""Comparison of a printed output with the output that a document shows.

Words, punctuation and the order of lines are compared exactly, spaces are not. A figure with decimals or a unit is
measured; any other one is a count or an id. Both are compared by a `Tolerance`.
"""

import re
from dataclasses import dataclass
from itertools import pairwise

from tests.docs.pages import ROOT, blocks, commands

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d*)?(?:e[+-]?\d+)?(?![\w])")
"""A figure that stands alone: the digits of `ur5e` and of an id are words."""
DURATION_UNIT = re.compile(r"\s*(?:ms|s)\b")
"""What follows a duration. Durations depend on the machine and are not compared."""

UNIT = re.compile(r"(?:[,\s]*-?[\d.]+)*[)\]]?\s*(?:mm|m|rad|degrees|%)(?!\w)")
"""What follows a measured figure, also within a list of them."""


@dataclass(frozen=True)
class Tolerance:
    """Accepted deviations of printed figures from the shown ones."""

    relative: float
    """Deviation of a figure, as a share of the shown one."""
    digits: float
    """Deviation of a measured figure that is always accepted, in units of the last shown digit."""
    exact_below: float
    """Counts and ids below this one are equal. Larger ones may deviate by `relative`."""


SEEDED = Tolerance(relative=0.001, digits=1.0, exact_below=float("inf"))
"""For results that depend on a seed only: counts are equal, and processors differ in the last digits."""
LIVE = Tolerance(relative=0.05, digits=1.0, exact_below=20.0)
"""For live scans of the simulated cell, whose noise depends on when and where each image is taken."""

LOOSE = Tolerance(relative=0.3, digits=2.0, exact_below=20.0)
"""For figures that differ much from run to run, such as the error of one scan."""
WORDS = Tolerance(relative=float("inf"), digits=0.0, exact_below=0.0)
"""For an output of another cell than the one that the page describes: figures are not compared."""


def shown_after(page: str, command: str) -> str:
    """Return the output that a page shows directly after the block with a command."""
    pairs = pairwise(blocks(ROOT / page))
    (shown,) = [after.text for block, after in pairs if command in commands(block) and after.language == "text"]
    return shown


def differences(shown: str, printed: str, tolerance: Tolerance) -> list[str]:
    """Return a message for each line in which an output differs from the shown one."""
    shown_lines = [line for line in shown.splitlines() if line.strip()]
    printed_lines = [line for line in printed.splitlines() if line.strip()]
    if len(shown_lines) != len(printed_lines):
        return [f"{len(shown_lines)} lines are shown, {len(printed_lines)} were printed:\n{printed}"]
    pairs = zip(shown_lines, printed_lines, strict=True)
    return [f"shown: {ours}\nprinted: {theirs}" for ours, theirs in pairs if not _same_line(ours, theirs, tolerance)]


def _same_line(shown: str, printed: str, tolerance: Tolerance) -> bool:
    if _words(shown) != _words(printed):
        return False
    pairs = zip(NUMBER.finditer(shown), NUMBER.finditer(printed), strict=True)
    return all(_agree(ours, theirs, tolerance) for ours, theirs in pairs)


def _words(line: str) -> str:
    """Return a line without spaces, with a mark in place of each figure."""
    return "".join(NUMBER.sub("#", line).split())


def _agree(shown: re.Match[str], printed: re.Match[str], tolerance: Tolerance) -> bool:
    """Return whether two figures agree. The one with fewer decimals gives the unit of the last digit."""
    if DURATION_UNIT.match(shown.string, shown.end()):
        return True
    value = abs(float(shown[0]))
    deviation = abs(float(shown[0]) - float(printed[0]))
    is_measured = "." in shown[0] or UNIT.match(shown.string, shown.end())
    if not is_measured:
        return deviation <= (0 if value < tolerance.exact_below else tolerance.relative * value)
    last_digit = 10.0 ** -min(len(figure[0].partition(".")[2]) for figure in (shown, printed))
    return deviation <= max(tolerance.relative * value, 1.001 * tolerance.digits * last_digit)
