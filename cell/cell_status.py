"""In which state a cell is."""

from dataclasses import dataclass
from typing import Literal

from calibration.storage import HandEye
from cell.devices import ArmInfo, ArmState, CameraInfo
from cell.viewpoints import ViewpointPlan

State = Literal["not_ready", "ready", "busy", "fault"]


@dataclass(frozen=True)
class CellStatus:
    """The cell as last seen; reading it asks no device anything."""

    state: State = "not_ready"
    reason: str | None = "not connected yet: connect, or start a live scan"
    """Why it is not ready, and what to do."""
    slug: str | None = "not-connected"
    """The same for programs."""
    arm: ArmInfo | None = None
    arm_state: ArmState | None = None
    camera: CameraInfo | None = None
    hand_eye: HandEye | None = None
    plan: ViewpointPlan | None = None
    """The last one."""
