"""One cell: its arm, camera and calibration, and in which state they are."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

from calibration.storage import HandEye
from cell.camera import LiveCamera
from cell.cell_calibration import hand_eye_in_use, require_unchanged
from cell.cell_header import scan_header
from cell.cell_status import FAULTS, CellStatus, KeptStatus
from cell.connecting import connect_equipment
from cell.equipment import Equipment
from cell.errors import (
    AcknowledgeRequiredError,
    CellBusyError,
    CellError,
    NothingToAcknowledgeError,
    StoppedError,
)
from cell.recording import RecordingWriter
from cell.recording_header import RecordingHeader
from cell.scan import BackgroundScan, ScanListener, ScanMeans
from cell.settings import CellSettings
from cell.viewpoints import ViewpointPlan, plan_viewpoints, require_enough

log = logging.getLogger(__name__)

TURN_S = 1.0
"""How long a method waits for the arm and the camera; the watch has them for a moment only."""
HOME_S = 20.0
"""Whoever asks for a scan waits so long for the arm of the last one to come home."""
WATCH_S = 0.5
"""How often an idle arm is looked at."""
STOPPED = "stopped by request: connect, or start a live scan"


class Cell:
    """Connects, watches, scans and stops. Safe to use from any thread; `stop` and `give_up_connecting` wait for no
    other method."""

    def __init__(self, settings: CellSettings) -> None:
        """Touches no device: that is for `connect`."""
        self.settings = settings
        self._equipment = Equipment(settings)
        self._turn = threading.Lock()
        """Of using arm and camera."""
        self._status = KeptStatus()
        self._last_stop = object()
        """Another one with every stop that somebody asks for ..."""
        self._stop_before = self._last_stop
        """... and the last before the scan that was prepared: it no longer counts."""
        self._closing = threading.Event()
        self._watch = threading.Thread(target=self._watch_idle, name="cell-watch", daemon=True)
        self._watch.start()

    @property
    def status(self) -> CellStatus:
        """The cell as last seen."""
        status, latest = self._status.now, self._equipment.latest_arm_state
        return status if latest is None else replace(status, arm_state=latest)

    @property
    def controller_host(self) -> str | None:
        """Where the arm's controller listens; None before a simulated one was started."""
        return self._equipment.controller_address

    @property
    def camera(self) -> LiveCamera:
        """The camera; for one thread at a time, when no scan is under way."""
        return self._equipment.camera

    def connect(self) -> None:
        """Connects arm and camera, unless they are; nothing moves.

        Raises:
            AcknowledgeRequiredError: there was a fault that nobody has acknowledged.
            CellBusyError: a scan is under way.
            CellError: arm, camera or calibration cannot be used, with the reason.
            StoppedError: a stop came meanwhile.
        """
        with self._using():
            self._connect()

    def plan(self, views: int | None = None) -> ViewpointPlan:
        """The viewpoints from where the arm stands, or stood last; asks no device anything, nothing moves.

        Raises:
            CalibrationError: without it nobody knows where the camera is.
            ViewpointsError: the arm stands where no path leads from.
        """
        state = self.status.arm_state
        settings = self._for_views(views)
        plan = plan_viewpoints(settings, self._calibration().T_flange_camera, None if state is None else state.q_rad)
        self._status.change(plan=plan)
        return plan

    def prepare(self, views: int | None = None) -> ViewpointPlan:
        """Makes sure that a scan can be done, and plans it; connects first if need be. Nothing moves.

        Raises: as `connect` and `plan`, and ViewpointsError when too few viewpoints can be reached.
        """
        before = self._last_stop
        with self._using(HOME_S):
            self._connect()
            plan = self.plan(views)
            require_enough(plan, self._for_views(views).scan.min_views)
            self._stop_before = before
            self._refuse_stopped_since(before)
            return plan

    def header(self, radius_m: float | None) -> RecordingHeader:
        """Of the recording of a scan that was prepared; `radius_m` None: not known."""
        return scan_header(self._status.now, self.settings, self._equipment.camera.depth_unit_m, radius_m)

    @contextlib.contextmanager
    def scanning(
        self, plan: ViewpointPlan, writer: RecordingWriter, listener: ScanListener
    ) -> Iterator[BackgroundScan]:
        """A scan by `plan`, as `prepare` gave it; it has begun when the body is entered.

        Left by an exception, an arm that may still move is stopped; left in order, it is waited for until it is home.
        Raises what the scan does, CellBusyError, and StoppedError when a stop came since `prepare`.
        """
        with self._using():
            before = self._stop_before
            self._refuse_stopped_since(before)
            hand_eye = self._status.now.hand_eye
            assert hand_eye is not None
            # Whatever else has happened to the arm since it was prepared, the scan's beginning tells.
            self._status.change(state="busy", slug="cell-busy", reason="a scan is under way")
            means = ScanMeans(
                self._equipment.arm,
                self._equipment.camera,
                hand_eye.T_flange_camera,
                self.settings.camera.settle_s,
                self._unchanged(hand_eye),
            )
            least = min(self.settings.scan.min_views, len(plan.viewpoints))
            scan = BackgroundScan(
                means,
                plan,
                writer,
                listener,
                least,
                lambda: self._status.change(reason="all views of the last scan are taken, the arm goes home"),
            )
            try:
                scan.start()
                yield scan
                scan.wait()
            except BaseException as error:
                # The scan's own errors leave the arm still, or on its way home.
                if error is not scan.error and scan.at_work:
                    self._equipment.stop()
                self._join(scan)
                raise
            finally:
                self._status.after(scan.error, FAULTS)
                if self._last_stop is not before:  # one that came when the arm was home already
                    self._status.no_longer_ready("stopped", STOPPED)

    def stop(self) -> None:
        """Stops the arm, whatever goes on. The scan under way or being prepared, if any, ends with StoppedError."""
        self._last_stop = object()
        self._equipment.stop()
        self._status.no_longer_ready("stopped", STOPPED)

    def release(self) -> None:
        """Ends our program on the robot, so that another can move it; the camera stays connected. Nothing moves.

        The next `connect` or `prepare` takes the arm again.

        Raises:
            AcknowledgeRequiredError: there was a fault that nobody has acknowledged.
            CellBusyError: a scan is under way.
        """
        with self._using(HOME_S):
            if self._status.now.state == "fault":
                raise AcknowledgeRequiredError(self._status.now.reason)
            self._equipment.release_arm()
            reason = "the arm was let go for other programs: connect, or start a live scan"
            self._status.change(state="not_ready", slug="released", reason=reason)

    def acknowledge(self) -> None:
        """A person has looked at the cell after a fault: the robot is unlocked, its program ended. Nothing moves.

        Raises:
            NothingToAcknowledgeError: there is no fault.
            TooEarlyError: the robot cannot be unlocked yet.
            CellError: the robot does not answer, or does not unlock.
        """
        with self._using():
            if self._status.now.state != "fault":
                raise NothingToAcknowledgeError("there is no fault to acknowledge")
            self._equipment.arm.acknowledge()
            reason = "acknowledged: connect, or start a live scan"
            self._status.change(state="not_ready", slug="not-connected", reason=reason)

    def give_up_connecting(self) -> None:
        """Before `close`, for good: nobody waits any more for a camera that is not connected yet."""
        self._equipment.give_up_connecting()

    def close(self) -> None:
        """Stops the arm and lets everything go."""
        self._closing.set()
        self.give_up_connecting()
        if self._status.now.state == "busy":
            self._equipment.stop()
        self._watch.join()
        with self._turn:
            self._equipment.close()
            self._status.change(state="not_ready", slug="not-ready", reason="the service is ending")

    def _join(self, scan: BackgroundScan) -> None:
        try:
            scan.join()
        except BaseException:  # whoever waits is interrupted: the arm must not go on alone
            self._equipment.stop()
            scan.join()
            raise

    def _refuse_stopped_since(self, before: object) -> None:
        if self._last_stop is not before:
            self._status.no_longer_ready("stopped", STOPPED)
            raise StoppedError("the arm was stopped by request before the scan began")

    def _connect(self) -> None:
        status, before = self._status.now, self._last_stop
        if status.state == "fault":
            raise AcknowledgeRequiredError(status.reason)
        try:
            hand_eye = self._calibration()
            seen = connect_equipment(self._equipment, hand_eye, status.arm if status.state == "ready" else None)
        except CellError as error:
            self._status.after(error)
            raise
        self._status.change(state="ready", reason=None, slug=None, hand_eye=hand_eye, **vars(seen))
        self._refuse_stopped_since(before)

    def _calibration(self) -> HandEye:
        return hand_eye_in_use(self.settings.hand_eye, self._equipment.world)

    def _unchanged(self, used: HandEye) -> Callable[[], None]:
        return lambda: require_unchanged(used, self._calibration())

    def _for_views(self, views: int | None) -> CellSettings:
        if views is None:
            return self.settings
        least = min(views, self.settings.scan.min_views)
        scan = self.settings.scan.model_copy(update={"views": views, "min_views": least})
        return self.settings.model_copy(update={"scan": scan})

    @contextlib.contextmanager
    def _using(self, wait_s: float = TURN_S) -> Iterator[None]:
        if self._closing.is_set() or not self._turn.acquire(timeout=wait_s):
            raise CellBusyError("the arm is in use: wait for the end of the scan, or stop it")
        try:
            if self._closing.is_set():
                raise CellBusyError("the service is ending")
            yield
        finally:
            self._turn.release()

    def _watch_idle(self) -> None:
        """What happens to an idle arm is noticed too, and its watchdog kept quiet."""
        while not self._closing.wait(WATCH_S):
            if self._status.now.state != "ready" or not self._turn.acquire(blocking=False):
                continue
            try:
                if self._status.now.state == "ready":
                    self._equipment.arm.check_ready()
            except CellError as error:
                self._status.after(error)
            except Exception as error:  # the watch goes on: nobody else would notice
                log.exception("the idle arm could not be looked at")
                self._status.after(error)
            finally:
                self._turn.release()
