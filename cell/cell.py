"""One cell: its arm, camera and calibration, and in which state they are."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

from calibration.storage import HandEye
from cell.camera import LiveCamera
from cell.cell_calibration import hand_eye_in_use, require_its_own, require_unchanged
from cell.cell_status import CellStatus, State
from cell.devices import CameraInfo
from cell.equipment import Equipment
from cell.errors import (
    AcknowledgeRequiredError,
    CameraLostError,
    CellBusyError,
    CellError,
    EmergencyStopError,
    MotionError,
    NothingToAcknowledgeError,
    ProtectiveStopError,
    RobotLostError,
    StoppedError,
)
from cell.recording import RecordingWriter
from cell.recording_header import RecordingHeader
from cell.scan import BackgroundScan, ScanListener, ScanMeans
from cell.settings import CellSettings
from cell.viewpoints import ViewpointPlan, plan_viewpoints, require_enough

log = logging.getLogger(__name__)

SAFETY_STOPS = (ProtectiveStopError, EmergencyStopError)
"""A person must look at the cell and acknowledge them ..."""
FAULTS = (*SAFETY_STOPS, RobotLostError, MotionError)
"""... and these, when the arm was moving: nobody else knows how it stands."""

TURN_S = 1.0
"""How long a method waits for the arm and the camera; the watch has them for a moment only."""
HOME_S = 20.0
"""Whoever asks for a scan waits so long for the arm of the last one to come home."""
WATCH_S = 0.5
"""How often an idle arm is looked at."""


class Cell:
    """Connects, watches, scans and stops. Safe to use from any thread; `stop` waits for no other method."""

    def __init__(self, settings: CellSettings) -> None:
        """Touches no device: that is for `connect`."""
        self.settings = settings
        self._equipment = Equipment(settings)
        self._turn = threading.Lock()
        """Of using arm and camera."""
        self._status = CellStatus()
        self._stops = 0
        """How often somebody has asked for a stop ..."""
        self._stops_before = 0
        """... and how often before the last scan was prepared: those no longer count."""
        self._closing = threading.Event()
        self._watch = threading.Thread(target=self._watch_idle, name="cell-watch", daemon=True)
        self._watch.start()

    @property
    def status(self) -> CellStatus:
        """The cell as last seen."""
        status, latest = self._status, self._equipment.latest_arm_state
        return replace(status, arm_state=latest) if status.state in ("ready", "busy") else status

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
        self._status = replace(self._status, plan=plan)
        return plan

    def prepare(self, views: int | None = None) -> ViewpointPlan:
        """Makes sure that a scan can be done, and plans it; connects first if need be. Nothing moves.

        Raises: as `connect` and `plan`, and ViewpointsError when too few viewpoints can be reached.
        """
        stops = self._stops
        with self._using(HOME_S):
            self._connect()
            self._stops_before = stops
            plan = self.plan(views)
            require_enough(plan, self._for_views(views).scan.min_views)
            return plan

    def header(self, radius_m: float | None) -> RecordingHeader:
        """Of the recording of a scan that was prepared; `radius_m` None: not known."""
        status = self._status
        assert status.hand_eye is not None
        assert status.arm is not None
        assert status.camera is not None
        return RecordingHeader(
            depth_unit_m=self._equipment.camera.depth_unit_m,
            string_radius_m=radius_m,
            T_flange_camera=status.hand_eye.T_flange_camera,
            table_z_m=self.settings.mounting.table_z_m,
            workspace_m=self.settings.workspace_m,
            provenance={
                "camera": f"{status.camera.product} {status.camera.device_id}",
                "robot": f"{status.arm.model} {status.arm.serial}, software {status.arm.software}",
                "calibration_sha256": status.hand_eye.sha256,
            },
        )

    @contextlib.contextmanager
    def scanning(
        self, plan: ViewpointPlan, writer: RecordingWriter, listener: ScanListener
    ) -> Iterator[BackgroundScan]:
        """A scan by `plan`, as `prepare` gave it; it has begun when the body is entered.

        Left by an exception, the arm is stopped; left in order, it is waited for until it is home. Raises what the
        scan does, CellBusyError, and StoppedError when a stop came since `prepare`.
        """
        with self._using():
            status = self._status
            if status.state != "ready" or self._stops != self._stops_before:
                raise StoppedError(f"the scan did not begin: {status.reason or 'the arm was stopped by request'}")
            assert status.hand_eye is not None
            self._set("busy", "cell-busy", "a scan is under way")
            means = ScanMeans(
                self._equipment.arm,
                self._equipment.camera,
                status.hand_eye.T_flange_camera,
                self.settings.camera.settle_s,
                self._unchanged(status.hand_eye),
            )
            least = min(self.settings.scan.min_views, len(plan.viewpoints))
            scan = BackgroundScan(means, plan, writer, listener, least)
            try:
                yield scan
                scan.wait()
            except BaseException as error:
                if error is not scan.error:  # the scan's own errors leave the arm still, or on its way home
                    self._equipment.stop()
                self._join(scan)
                self._after(scan.error, FAULTS)
                raise
            self._after(None)

    def stop(self) -> None:
        """Stops the arm, whatever goes on. The scan under way or being prepared, if any, ends with StoppedError."""
        self._stops += 1
        self._equipment.stop()
        if self._status.state == "ready":
            self._set("not_ready", "stopped", "stopped by request: connect, or start a live scan")

    def acknowledge(self) -> None:
        """A person has looked at the cell after a fault: the robot is unlocked, its program ended. Nothing moves.

        Raises:
            NothingToAcknowledgeError: there is no fault.
            TooEarlyError: the robot cannot be unlocked yet.
            CellError: the robot does not answer, or does not unlock.
        """
        with self._using():
            if self._status.state != "fault":
                raise NothingToAcknowledgeError("there is no fault to acknowledge")
            self._equipment.arm.acknowledge()
            self._set("not_ready", "not-connected", "acknowledged: connect, or start a live scan")

    def close(self) -> None:
        """Stops the arm and lets everything go."""
        self._closing.set()
        self._equipment.stop()
        self._watch.join()
        with self._turn:
            self._equipment.close()
            self._status = CellStatus(reason="the service is ending", slug="not-ready")

    def _join(self, scan: BackgroundScan) -> None:
        try:
            scan.join()
        except BaseException:  # whoever waits is interrupted: the arm must not go on alone
            self._equipment.stop()
            scan.join()
            raise

    def _still_ready(self) -> bool:
        """The arm that was ready is; not when it was stopped since. Raises what else is wrong with it."""
        try:
            self._equipment.arm.check_ready()
        except StoppedError:
            return False
        return True

    def _camera_info(self) -> CameraInfo:
        camera = self._equipment.camera
        if camera.connected:
            try:
                return camera.info()
            except CameraLostError as error:
                log.warning("%s; connecting it once more", error)
        return camera.connect()

    def _connect(self) -> None:
        status = self._status
        if status.state == "fault":
            raise AcknowledgeRequiredError(f"{status.reason} Look at the cell, then acknowledge.")
        try:
            hand_eye = self._calibration()
            arm = self._equipment.arm
            info = status.arm
            if status.state != "ready" or info is None or not self._still_ready():
                info = arm.connect()
            seen = self._camera_info()
            state = arm.state()
            require_its_own(hand_eye, seen.device_id, info.serial)
        except CellError as error:
            self._after(error)
            raise
        self._status = replace(
            status, state="ready", reason=None, slug=None, arm=info, arm_state=state, camera=seen, hand_eye=hand_eye
        )

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
            yield
        finally:
            self._turn.release()

    def _after(self, error: BaseException | None, faults: tuple[type[CellError], ...] = SAFETY_STOPS) -> None:
        """The state that follows from how something ended."""
        if error is None:
            self._set("ready", None, None)
        elif isinstance(error, faults) and isinstance(error, CellError):
            log.warning("fault: %s", error)
            self._set("fault", error.slug, str(error))
        elif isinstance(error, CellError):
            self._set("not_ready", error.slug, str(error))
        else:
            self._set("not_ready", "stopped", "the last scan ended in an error: connect, or start a live scan")

    def _set(self, state: State, slug: str | None, reason: str | None) -> None:
        self._status = replace(self._status, state=state, slug=slug, reason=reason)

    def _watch_idle(self) -> None:
        """What happens to an idle arm is noticed too, and its watchdog kept quiet."""
        while not self._closing.wait(WATCH_S):
            if self._status.state != "ready" or not self._turn.acquire(blocking=False):
                continue
            try:
                self._equipment.arm.check_ready()
            except CellError as error:
                self._after(error)
            finally:
                self._turn.release()
