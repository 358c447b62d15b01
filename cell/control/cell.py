"""The robot cell: connect, prepare, run, stop.

`Cell.run` is the control flow of a live scan, of a calibration and of a verification. The state of the cell is
`not_ready`, `ready`, `busy` or `fault`, and changes only so:

| change | by | thread |
|---|---|---|
| not_ready -> ready | `connect`, `prepare_*`: devices and calibration can be used | caller, with the equipment's lock |
| not_ready or ready -> fault or not_ready | `connect`, `prepare_*`: they cannot | caller, with the lock |
| not_ready or ready -> busy -> ready | `run`, at its start and its end | caller, with the lock |
| busy -> fault or not_ready | an error of the run, as soon as the arm is at rest | `motion` |
| busy -> not_ready | `run`, at its end after a stop or without a usable calibration | caller, with the lock |
| ready -> not_ready | `stop`, `calibration_changed` | any, without the lock |
| ready -> not_ready | a request older than a stop that is later than the connection | caller, with the lock |
| ready -> fault or not_ready | the idle monitor | `cell-monitor`, with the lock |
| not_ready or ready -> not_ready | `release`, `close` | caller, with the lock |
| fault -> not_ready | `acknowledge` | caller, with the lock |
| not_ready -> fault | `restore_fault`, at the start of the service | caller |

A stop that comes during `run` makes the next `Arm.move` raise StoppedError, which ends the run. A request that is older
than the last stop is rejected by `StopRequests.raise_if_stopped_since`. The diagram is in
docs/contributor/cell-states.md.
"""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.camera.camera import LiveCamera
from cell.config.cell_config import CellSettings
from cell.config.scan_views import Views
from cell.control.active_calibration import require_unchanged
from cell.control.background_scan import BackgroundScan
from cell.control.early_end import EarlyEnd
from cell.control.equipment import Equipment
from cell.control.idle_monitor import IdleMonitor
from cell.control.preparation import Preparation
from cell.control.prepared import Prepared, PreparedCalibration, PreparedScan, PreparedVerification
from cell.control.progress import ProgressListener
from cell.control.scan_loop import ScanContext, ViewWriter, return_home, take_views
from cell.control.status import FAULTS, CellStatus, Listener, SharedStatus
from cell.control.stop_requests import StopRequests
from cell.errors import (
    STOPPED,
    CalibrationError,
    CellBusyError,
    NothingToAcknowledgeError,
    StoppedError,
)
from cell.planning.calibration_poses import HELD_OUT, POSES
from cell.planning.viewpoints import ViewpointPlan, require_enough

LOCK_TIMEOUT_S = 1.0
"""Timeout for acquiring the lock of the equipment. The idle monitor holds it only for a moment."""
END_TIMEOUT_S = 10.0
"""The same timeout after a fault, which the cell reports before its run has ended."""
HOME_TIMEOUT_S = 20.0
"""The same timeout for a request that may wait until the arm of the last scan is home."""


class Cell:
    """The devices of one cell and what they do.

    Every method may be called from any thread. `stop` and `cancel_connecting` wait for no other method.
    """

    def __init__(self, settings: CellSettings) -> None:
        """Create the cell; no device is used before `connect`."""
        self.settings = settings
        self._equipment = Equipment(settings)
        self._lock = threading.Lock()  # of the equipment
        self._status = SharedStatus()
        self._stops = StopRequests(self._status)
        self._preparation = Preparation(settings, self._equipment, self._status, self._stops)
        self._closing = threading.Event()
        self._monitor = IdleMonitor(self._equipment, self._status, self._lock)

    @property
    def status(self) -> CellStatus:
        """Last known status of the cell."""
        status, latest = self._status.now, self._equipment.latest_arm_state
        return status if latest is None else replace(status, arm_state=latest)

    def on_status(self, listener: Listener) -> None:
        """Call `listener` at each change of the status from now on, in order and from any thread.

        The listener must not wait: a stop may wait for it.
        """
        self._status.subscribe(listener)

    @property
    def controller_host(self) -> str | None:
        """Address of the arm's controller, or None before a simulated one was started."""
        return self._equipment.controller_address

    @property
    def camera(self) -> LiveCamera:
        """The camera, for one thread at a time while nothing runs."""
        return self._equipment.camera

    def hand_eye(self) -> HandEye:
        """Load the active calibration from its file. No device is queried.

        Raises:
            CalibrationError: There is no usable calibration.
        """
        return self._preparation.active_hand_eye()

    def connect(self) -> None:
        """Connect arm and camera, unless they are connected. The arm does not move.

        Raises:
            AcknowledgeRequiredError: A fault has not been acknowledged.
            CellBusyError: A scan runs.
            CellError: Arm, camera or calibration cannot be used.
            StoppedError: A stop was requested meanwhile.
        """
        with self._exclusive():
            self._preparation.connect_for_scan()

    def plan(self, views: Views | None = None) -> ViewpointPlan:
        """Plan the viewpoints of a scan from the arm's last known posture. No device is queried.

        Args:
            views: Number of viewpoints or `auto`, or None for the configured value.

        Raises:
            CalibrationError: There is no usable calibration.
            ViewpointsError: No path leads from the arm's posture.
        """
        return self._preparation.plan_scan(views, self._preparation.active_hand_eye())

    def check_scan(self, requested_at: float) -> None:
        """Check what can be known at once of whether a scan is possible. No device is queried.

        Args:
            requested_at: Time of the request, seconds of `time.monotonic()`.

        Raises:
            AcknowledgeRequiredError: A fault has not been acknowledged.
            CalibrationError: There is no usable calibration, or it is not of the connected camera and arm.
            StoppedError: A stop was requested since `requested_at`.
        """
        self._preparation.check_scan(requested_at)

    def validate_scan(self, views: Views | None, requested_at: float) -> ViewpointPlan:
        """Plan a scan as far as possible without a device, from the arm's last known posture.

        Args:
            views: Number of viewpoints or `auto`, or None for the configured value.
            requested_at: As for `check_scan`.

        Raises:
            ViewpointsError: Too few viewpoints are reachable.
            CellError: As `check_scan`.
        """
        self.check_scan(requested_at)
        plan = self.plan(views)
        require_enough(plan, self.settings.for_views(views).scan.min_views)
        return plan

    def prepare_scan(self, views: Views | None, requested_at: float) -> PreparedScan:
        """Connect if needed, plan the viewpoints and check that enough are reachable. The arm does not move.

        Args:
            views: Number of viewpoints or `auto`, or None for the configured value.
            requested_at: Time of the request, seconds of `time.monotonic()`. A later stop cancels the scan.

        Raises:
            AcknowledgeRequiredError: A fault has not been acknowledged.
            CellBusyError: A scan runs.
            CellError: Arm, camera or calibration cannot be used.
            ViewpointsError: Too few viewpoints are reachable.
            StoppedError: A stop was requested since `requested_at`.
        """
        with self._exclusive(HOME_TIMEOUT_S):
            return self._preparation.scan(views, requested_at)

    def prepare_calibration(
        self, board: Board, requested_at: float, poses: int = POSES, held_out: int = HELD_OUT
    ) -> PreparedCalibration:
        """Connect if needed and plan camera poses around the board. The arm does not move.

        No calibration is needed, only an initial guess. At a simulated cell the board is put on the table.

        Args:
            board: Board on the table.
            requested_at: Time of the request, seconds of `time.monotonic()`. A later stop cancels the calibration.
            poses: Number of poses to calibrate from.
            held_out: Number of further poses for the verification.

        Raises:
            CalibrationError: There is no initial guess, it contradicts the active calibration, or the camera takes no
                intensity images.
            ViewpointsError: Too few poses are reachable.
            CellError: As `prepare_scan`.
        """
        with self._exclusive(HOME_TIMEOUT_S):
            return self._preparation.calibration(board, poses, held_out, requested_at)

    def prepare_verification(self, requested_at: float) -> PreparedVerification:
        """Connect if needed and plan two poses around the board of the active calibration. The arm does not move.

        The calibration may be of any age.

        Args:
            requested_at: Time of the request, seconds of `time.monotonic()`. A later stop cancels the verification.

        Raises:
            CalibrationError: There is no active calibration, or it cannot be verified.
            ViewpointsError: A pose is not reachable.
            CellError: As `prepare_scan`.
        """
        with self._exclusive(HOME_TIMEOUT_S):
            return self._preparation.verification(requested_at)

    @contextlib.contextmanager
    def run(self, prepared: Prepared, writer: ViewWriter, listener: ProgressListener) -> Iterator[BackgroundScan]:
        """Take the views of a prepared scan, calibration or verification around the body of a `with` statement.

        The body iterates over the views while the arm moves in the thread `motion`. A body that ends normally waits
        until the arm is home. If the body raises, an arm that may move is stopped. The views of a calibration or a
        verification have an intensity image. After one of these, the cell is ready only if a scan could use its
        calibration.

        Args:
            prepared: Result of a `prepare_*` method.
            writer: Writes each view to the disk before the arm leaves its viewpoint.
            listener: Receives the progress.

        Raises:
            AcknowledgeRequiredError: There has been a fault since the preparation.
            CellBusyError: Another run has the equipment.
            StoppedError: A stop was requested since `prepared.requested_at`.
            MissingViewsError: Fewer than `prepared.min_views` views were taken.
            CellError: An error of the arm, or a changed calibration, ended the run.
        """
        with self._exclusive():
            self._status.raise_if_fault()
            self._stops.raise_if_stopped_since(prepared.requested_at)
            is_scan, arm = prepared.purpose == "scan", self._equipment.arm
            settings, nominal = self.settings.hand_eye, self._equipment.nominal_hand_eye
            context = ScanContext(
                arm=arm,
                camera=self._equipment.camera,
                T_flange_camera=prepared.hand_eye.T_flange_camera,
                settle_s=self.settings.camera.settle_s,
                check=partial(require_unchanged, prepared, settings, nominal, datetime.now(UTC)),
                with_image=not is_scan,
            )

            def home() -> None:
                reason = f"all views of the last {prepared.purpose} are taken, the arm returns home"
                self._status.change(reason=reason)
                return_home(arm, prepared.plan)

            early_end = EarlyEnd(prepared.may_end_after if isinstance(prepared, PreparedScan) else None)
            views = take_views(context, prepared.plan, writer, listener, prepared.min_views, early_end)
            # a failure changes the state at once, whatever the body is doing
            scan = BackgroundScan(views, home, partial(self._status.set_outcome, faults=FAULTS), early_end)
            self._status.change(state="busy", slug="cell-busy", reason=f"a {prepared.purpose} is under way")
            try:
                with scan.running(self._equipment.stop):
                    yield scan
            finally:
                if scan.error is None:
                    stopped = self._stops.is_stopped_since(prepared.requested_at)  # when the arm was home already
                    self._status.set_outcome(StoppedError(STOPPED) if stopped else None)
                if not is_scan:
                    self._preparation.require_usable()
                if self._stops.is_stopped_since(prepared.requested_at):  # since the line above
                    self._stops.mark_not_ready()

    def calibration_changed(self) -> None:
        """Update the status after a change of the active calibration. No device is queried."""
        if self._preparation.require_usable() and self._status.now.slug == CalibrationError.slug:
            reason = "another calibration is in use now: connect, or start a live scan"
            self._status.change(slug="not-connected", reason=reason)

    def stop(self) -> None:
        """Stop the arm. A run, or the preparation of one, ends with StoppedError."""
        self._stops.record()
        self._equipment.stop()
        self._stops.mark_not_ready()

    def reject_earlier_requests(self) -> None:
        """Reject every request of before now whose run has not begun. A running arm continues."""
        self._stops.record()

    def wait_while_busy(self, timeout_s: float) -> None:
        """Wait until nothing runs, or until the timeout."""
        self._status.wait_while_busy(timeout_s)

    def release(self, requested_at: float) -> None:
        """End the program on the robot, so that another program can move it. The camera stays connected.

        The method waits until the arm is home. The next `connect` or `prepare_*` takes the arm again.

        Args:
            requested_at: Time of the request, seconds of `time.monotonic()`.

        Raises:
            AcknowledgeRequiredError: A fault has not been acknowledged.
            CellBusyError: A scan runs.
            StoppedError: A stop was requested since `requested_at`: the arm may not be home, and should not be moved.
        """
        with self._exclusive(HOME_TIMEOUT_S):
            self._status.raise_if_fault()
            self._stops.raise_if_stopped_since(requested_at)
            plan, state = self._status.now.plan, self._equipment.latest_arm_state
            away = plan is not None and state is not None and not plan.is_home(state.q_rad)
            self._equipment.release_arm()
            where = "where it stands, which is not its home posture" if away else "for other programs"
            reason = f"the arm was released {where}: connect, or start a live scan"
            self._status.change(state="not_ready", slug="released", reason=reason)

    def acknowledge(self) -> None:
        """Unlock the robot and end its program, after a person has inspected the cell. The arm does not move.

        The method waits until the run that the fault ended has given up the devices.

        Raises:
            CellBusyError: It has not, or a scan runs.
            NothingToAcknowledgeError: There is no fault.
            TooEarlyError: The robot cannot be unlocked yet.
            CellError: The robot does not answer, or does not unlock.
        """
        ending = self._status.now.state == "fault"
        with self._exclusive(END_TIMEOUT_S if ending else LOCK_TIMEOUT_S):
            if self._status.now.state != "fault":
                raise NothingToAcknowledgeError("there is no fault to acknowledge")
            self._equipment.arm.acknowledge()
            reason = "acknowledged: connect, or start a live scan"
            self._status.change(state="not_ready", slug="not-connected", reason=reason)

    def restore_fault(self, slug: str, reason: str) -> None:
        """Restore a fault of before the process's start that nobody has acknowledged. No device is queried."""
        self._status.change(state="fault", slug=slug, reason=reason)

    def cancel_connecting(self) -> None:
        """Let the current and every later connection of the camera fail at once. To be called before `close`."""
        self._equipment.cancel_connecting()

    def close(self) -> None:
        """Stop the arm and release all devices."""
        self._closing.set()
        self.cancel_connecting()
        if self._status.now.state == "busy":
            self._equipment.stop()
        self._monitor.end()
        with self._lock:
            self._equipment.close()
            if self._status.now.state != "fault":  # a fault stays until a person acknowledges it
                self._status.change(state="not_ready", slug="not-ready", reason="the service is ending")

    @contextlib.contextmanager
    def _exclusive(self, timeout_s: float = LOCK_TIMEOUT_S) -> Iterator[None]:
        """Hold the lock of the equipment. Raise CellBusyError after the timeout, or when the cell is being closed."""
        if self._closing.is_set() or not self._lock.acquire(timeout=timeout_s):
            raise CellBusyError("the arm is in use: wait for the end of the scan or calibration, or stop it")
        try:
            if self._closing.is_set():
                raise CellBusyError("the service is ending")
            yield
        finally:
            self._lock.release()
