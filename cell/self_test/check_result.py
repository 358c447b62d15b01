"""Result of one check, and what earlier checks found for later ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from calibration.storage.hand_eye_file import HandEye
from cell.config.cell_config import CellSettings
from cell.control.equipment import Equipment
from cell.devices import ArmInfo, ArmState, Burst, CameraInfo, Frame

Outcome = Literal["ok", "warning", "failed", "skipped"]


@dataclass(frozen=True)
class CheckResult:
    """Result of one check."""

    name: str
    """Name of the check."""
    outcome: Outcome
    """Outcome of the check."""
    message: str
    """What was found, or why the check was skipped."""
    what_to_do: str | None = None
    """Advice for a person at the cell, or None if nothing is wrong."""
    figures: Mapping[str, Any] | None = None
    """Measured values for programs, in metres and seconds, or None."""


@dataclass
class CheckContext:
    """What the checks have found. None means not found, or not checked yet."""

    settings: CellSettings
    """Settings of the cell."""
    equipment: Equipment
    """Devices of the cell."""
    address: str | None = None
    """Address of the controller, if all its ports answer."""
    arm: ArmInfo | None = None
    """Identity of a robot that may be driven."""
    state: ArmState | None = None
    """State of the arm, which does not move during the test."""
    camera: CameraInfo | None = None
    """Identity of the connected camera."""
    frame: Frame | None = None
    """Depth image of the camera."""
    hand_eye: HandEye | None = None
    """Active calibration."""
    burst: Burst | None = None
    """Single exposures of the camera, one after the other, of what `frame` shows."""


def ok(name: str, message: str, warnings: Sequence[str] = (), figures: Mapping[str, Any] | None = None) -> CheckResult:
    """Return the result of a passed check. Each warning says what is wrong and, after a colon, what to do."""
    if not warnings:
        return CheckResult(name, "ok", message, figures=figures)
    reasons, advice = _split_messages(warnings)
    return CheckResult(name, "warning", f"{message}; but {reasons}", advice, figures)


def failed(name: str, errors: Sequence[Exception], message: str = "") -> CheckResult:
    """Return the result of a failed check. Each error says what is wrong and, after a colon, what to do."""
    reasons, advice = _split_messages([str(error) for error in errors])
    return CheckResult(name, "failed", f"{message}; but {reasons}" if message else reasons, advice)


def _split_messages(messages: Sequence[str]) -> tuple[str, str | None]:
    """Split messages into what is wrong and what to do."""
    parts = [message.partition(": ") for message in messages]
    advice = "; ".join(dict.fromkeys(what_to_do for _, _, what_to_do in parts if what_to_do))
    return "; ".join(wrong for wrong, _, _ in parts), advice or None
