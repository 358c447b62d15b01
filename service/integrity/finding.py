"""What the doctor finds."""

from dataclasses import dataclass
from typing import Literal

Group = Literal["data folder", "database", "recordings", "results", "calibrations", "tokens", "disk"]
GROUPS: tuple[Group, ...] = ("data folder", "database", "recordings", "results", "calibrations", "tokens", "disk")

Code = Literal[
    "folder-unusable", "leftover", "database-missing", "database-corrupt", "database-older", "database-newer",
    "database-locked", "database-unopened", "row-unreadable", "row-without-parent", "scan-unfinished",
    "recording-missing", "recording-changed", "recording-without-row", "view-lost", "result-missing",
    "result-changed", "result-without-row", "calibration-unfinished", "calibration-missing", "calibration-without-row",
    "tokens-open", "tokens-unreadable", "little-space",
]  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be."""

    group: Group
    code: Code
    where: str
    """Which file or row, as a person finds it."""
    what: str
    what_to_do: str
    repairable: bool
    """`--repair` mends it, or saves what can be saved."""
    key: str = ""
    """What it is about, for the repair: an id, the name of a file, a row as TABLE/ROWID."""


REPAIR = "run `pointchain doctor --repair` while no service runs"
