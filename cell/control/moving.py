"""What the arm is at while a scan or calibration is under way, and what is told of the cell before and behind it."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cell.config.cell_config import CellSettings
from cell.control.equipment import Equipment
from cell.control.planner import Basis
from cell.control.preparing import Preparing
from cell.control.scan_loop import BackgroundScan, ScanListener, ScanMeans, ViewWriter, attended
from cell.control.status import FAULTS, KeptStatus
from cell.control.stop_requests import Stops
from cell.errors import STOPPED, StoppedError
from cell.planning.viewpoints import ViewpointPlan


@dataclass(frozen=True)
class Task:
    """What the views are taken by, and how many there must be."""

    least: int
    """With fewer views it fails."""
    basis: Callable[[], Basis]
    """Gives what its plan was made with."""


class Moving:
    """Has views taken by a plan. Belongs to whoever uses arm and camera."""

    def __init__(
        self, settings: CellSettings, equipment: Equipment, status: KeptStatus, stops: Stops, preparing: Preparing
    ) -> None:
        self._settings, self._equipment, self._status = settings, equipment, status
        self._stops, self._preparing = stops, preparing

    @contextlib.contextmanager
    def under_way(
        self, plan: ViewpointPlan, writer: ViewWriter, listener: ScanListener, task: Task
    ) -> Iterator[BackgroundScan]:
        """The views that the body may iterate over, as `Cell.scanning` says; the arm is home, or stopped, behind it.

        Raises: what the scan does; StoppedError when a stop came since it was asked for.
        """
        asked_s = self._preparing.asked_s
        self._stops.refuse_since(asked_s)
        basis = task.basis()
        means = self._means(basis)
        # Whatever else has happened to the arm since it was prepared, the scan's beginning tells.
        self._status.change(state="busy", slug="cell-busy", reason=f"a {basis.what} is under way")
        going_home = f"all views of the last {basis.what} are taken, the arm goes home"
        scan = BackgroundScan(
            *(means, plan, writer, listener, task.least),
            going_home=lambda: self._status.change(reason=going_home),
            failed=lambda error: self._status.after(error, FAULTS),  # whatever the body is at
        )
        try:
            with attended(scan, self._equipment.stop):
                yield scan
        finally:
            if scan.error is None:
                stopped = self._stops.since(asked_s)  # when the arm was home already
                self._status.after(StoppedError(STOPPED) if stopped else None)
            if basis.what != "scan":  # it was begun without asking for one that can be used
                self._preparing.require_usable()
            if self._stops.since(asked_s):  # just now
                self._stops.told()

    def _means(self, basis: Basis) -> ScanMeans:
        arm, camera, settle_s = self._equipment.arm, self._equipment.camera, self._settings.camera.settle_s
        return ScanMeans(
            arm, camera, basis.hand_eye.T_flange_camera, settle_s, basis.check, picture=basis.what != "scan"
        )
