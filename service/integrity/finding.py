"""Findings of the integrity check."""

from dataclasses import dataclass
from typing import Literal

Group = Literal["data folder", "database", "recordings", "results", "calibrations", "tokens", "disk"]
GROUPS: tuple[Group, ...] = ("data folder", "database", "recordings", "results", "calibrations", "tokens", "disk")

Code = Literal[
    "folder-unusable", "leftover", "database-missing", "database-corrupt", "database-older", "database-newer",
    "database-unknown", "database-locked", "database-inaccessible", "row-unreadable", "row-without-parent",
    "scan-unfinished", "recording-missing", "recording-changed", "recording-without-row", "view-lost",
    "result-missing", "result-changed", "picture-changed", "result-without-row", "calibration-unfinished",
    "calibration-missing", "calibration-without-row", "tokens-open", "tokens-unreadable", "little-space",
]  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One inconsistency in the data folder."""

    group: Group
    code: Code
    where: str
    """The file or row, by its path or its name."""
    what: str
    """What is wrong; the subject is the file or row."""
    what_to_do: str
    repairable: bool
    """Whether `--repair` repairs it, or recovers what can be recovered."""
    key: str = ""
    """Argument of the repair, which is an id, a file name, or TABLE/ROWID."""


REPAIR = "run `pointchain doctor --repair` while no service runs"
IS_LINK = "it is a symbolic link, which is not followed"
