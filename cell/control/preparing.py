"""Making sure that what is planned can be done, before anything moves."""

import time
from collections.abc import Callable

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.control.connecting import connect_equipment
from cell.control.equipment import Equipment
from cell.control.planner import Planning
from cell.control.status import KeptStatus
from cell.control.stop_requests import Stops
from cell.errors import AcknowledgeRequiredError, CalibrationError, CellError
from cell.planning.viewpoints import ViewpointPlan


class Preparing:
    """Connects, has it planned, and says what a stop means for it. Belongs to whoever uses arm and camera."""

    def __init__(self, equipment: Equipment, status: KeptStatus, stops: Stops, planning: Planning) -> None:
        self._equipment, self._status, self._stops, self._planning = equipment, status, stops, planning
        self.asked_s = 0.0
        """When what was prepared was asked for: stops before that do not count."""

    def prepare(
        self,
        board: Board | None,
        calibration: Callable[[], HandEye] | None,
        planned: Callable[[], ViewpointPlan],
        asked_s: float,
    ) -> ViewpointPlan:
        """The plan that `planned` gives, once arm and camera are connected. `board` None: to scan.

        `calibration` tells the one that is needed; None: none is. `asked_s` is when it was asked for.

        Raises: as `connect`, and what `planned` does; StoppedError when a stop came since then.
        """
        self._equipment.lay_board(board)
        self.connect(calibration)
        try:
            plan = planned()
        except CellError:
            if calibration is None:
                self.require_usable()
            raise
        self.asked_s = asked_s
        self._stops.refuse_since(asked_s)
        return plan

    def connect(self, calibration: Callable[[], HandEye] | None) -> None:
        """Connects arm and camera, unless they are; `calibration` as in `prepare`.

        Raises:
            AcknowledgeRequiredError: there was a fault that nobody has acknowledged.
            CellError: arm, camera or calibration cannot be used, with the reason.
            StoppedError: a stop came meanwhile.
        """
        status, begun_s = self._status.now, time.monotonic()
        if status.state == "fault":
            raise AcknowledgeRequiredError(status.reason)
        if status.state != "ready":
            self._status.change(reason="arm and camera are being connected: nothing moves")
        try:
            hand_eye = None if calibration is None else calibration()
            seen = connect_equipment(self._equipment, hand_eye, status.arm if status.state == "ready" else None)
        except Exception as error:
            self._status.after(error)
            raise
        known = hand_eye or status.hand_eye
        self._status.change(state="ready", reason=None, slug=None, hand_eye=known, **vars(seen))
        self._stops.refuse_since(begun_s)

    def require_usable(self) -> bool:
        """A cell whose calibration a scan could not use is not ready. Whether it could."""
        try:
            self._planning.require_usable()
        except CalibrationError as error:
            self._status.no_longer_ready(error.slug, str(error))
            return False
        return True
