"""What testing a cell step by step is made of: what each step says, and what earlier steps found for later ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from calibration.storage.hand_eye_file import HandEye
from cell.config.cell_config import CellSettings
from cell.control.equipment import Equipment
from cell.devices import ArmInfo, ArmState, CameraInfo, Frame

Outcome = Literal["ok", "warning", "failed", "skipped"]


@dataclass(frozen=True)
class Step:
    """One thing that was tested."""

    name: str
    outcome: Outcome
    words: str
    """What was found, or why it was not looked at."""
    what_to_do: str | None = None
    """For a person at the cell, where something is wrong."""


@dataclass
class Grounds:
    """What steps find. None: not found, or not looked for yet."""

    settings: CellSettings
    equipment: Equipment
    address: str | None = None
    """The controller's, all of whose ports answer."""
    arm: ArmInfo | None = None
    """A robot that may be driven."""
    state: ArmState | None = None
    """Of the arm, as it stands during the whole test."""
    camera: CameraInfo | None = None
    frame: Frame | None = None
    hand_eye: HandEye | None = None


def ok(name: str, words: str, warnings: Sequence[str] = ()) -> Step:
    """A step that succeeded. Each warning says what is wrong and, after a colon, what to do."""
    if not warnings:
        return Step(name, "ok", words)
    told, advice = _apart(warnings)
    return Step(name, "warning", f"{words}; but {told}", advice)


def failed(name: str, errors: Sequence[Exception], words: str = "") -> Step:
    """A step that failed after it found what `words` say. The cell's errors, too, say after a colon what to do."""
    told, advice = _apart([str(error) for error in errors])
    return Step(name, "failed", f"{words}; but {told}" if words else told, advice)


def _apart(messages: Sequence[str]) -> tuple[str, str | None]:
    """What is wrong, and what to do about it."""
    parts = [message.partition(": ") for message in messages]
    advice = "; ".join(dict.fromkeys(what_to_do for _, _, what_to_do in parts if what_to_do))
    return "; ".join(wrong for wrong, _, _ in parts), advice or None
