"""What the cell plans: from its settings, the calibration in use, and where the arm stands. Nothing moves."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.config.cell_config import CellSettings
from cell.control.active_calibration import (
    RoughHandEyes,
    hand_eye_in_use,
    require_its_own,
    require_still_verified,
    require_unchanged,
)
from cell.control.equipment import Equipment
from cell.control.status import CellStatus
from cell.errors import CalibrationError
from cell.planning.calibration_poses import plan_calibration, plan_verification
from cell.planning.viewpoints import ViewpointPlan, plan_viewpoints


@dataclass(frozen=True, eq=False)
class Basis:
    """What a plan was made for, and by what."""

    what: Literal["scan", "calibration", "verification"]
    """All but a scan's views have pictures."""
    hand_eye: HandEye
    """The calibration, of a first one a rough one; a view's `T_flange_camera` is of it."""
    check: Callable[[], None]
    """Before each move: raises CalibrationError when that is no longer the one to use."""


class Planning:
    """Plans, and remembers by what the last calibration or verification was planned."""

    def __init__(self, settings: CellSettings, equipment: Equipment, status: Callable[[], CellStatus]) -> None:
        self._settings, self._equipment, self._status = settings, equipment, status
        self._last: tuple[ViewpointPlan, Basis] | None = None

    def hand_eye(self, moment: datetime | None = None) -> HandEye:
        """The calibration in use, as its file is now, not too old at `moment`, or at present. Raises
        CalibrationError."""
        return hand_eye_in_use(self._settings.hand_eye, self._equipment.world, moment)

    def require_usable(self) -> None:
        """Refuses a calibration that a scan by this camera and robot could not use. Raises CalibrationError."""
        require_its_own(self.hand_eye(), *self._ids)

    def scan(self, views: int | None) -> ViewpointPlan:
        """Viewpoints to scan from. Raises CalibrationError, ViewpointsError."""
        return plan_viewpoints(self._settings.for_views(views), self.hand_eye().T_flange_camera, self._q_rad)

    def calibration(self, board: Board, told: RoughHandEyes, poses: int, held_out: int) -> ViewpointPlan:
        """Poses to calibrate from. Raises CalibrationError, ViewpointsError."""
        rough = told.of(*self._ids)
        plan = plan_calibration(self._settings, board, rough.T_flange_camera, self._q_rad, poses, held_out)
        self._last = plan, Basis("calibration", rough, lambda: None)
        return plan

    def verification(self, board: Board, hand_eye: HandEye) -> ViewpointPlan:
        """Poses to verify from. Raises ViewpointsError."""
        plan = plan_verification(self._settings, board, hand_eye.T_flange_camera, self._q_rad)
        settings = self._settings.hand_eye
        self._last = plan, Basis("verification", hand_eye, lambda: require_still_verified(hand_eye, settings))
        return plan

    def basis(self, plan: ViewpointPlan) -> Basis:
        """By what the last calibration or verification was planned. Raises CalibrationError: `plan` is another."""
        if self._last is None or self._last[0] is not plan:
            raise CalibrationError("the calibration was not the last one to be prepared: begin anew")
        return self._last[1]

    def scan_basis(self) -> Basis:
        """By what a scan that was prepared is to be done."""
        used = self._status().hand_eye
        assert used is not None
        begun = datetime.now(UTC)  # neither midnight nor a clock that is set makes it too old on the way
        return Basis("scan", used, lambda: require_unchanged(used, self.hand_eye(begun)))

    @property
    def _ids(self) -> tuple[str | None, str | None]:
        """Of the camera and the robot, as far as they are known."""
        status = self._status()
        camera_id = None if status.camera is None else status.camera.device_id
        return camera_id, None if status.arm is None else status.arm.serial

    @property
    def _q_rad(self) -> NDArray[np.float64] | None:
        """Where the arm stands, or stood last."""
        state = self._status().arm_state
        return None if state is None else state.q_rad
