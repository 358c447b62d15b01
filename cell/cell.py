"""One cell: its arm, camera and calibration, and in which state they are."""

import contextlib
import hashlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from calibration.errors import HandEyeError
from calibration.storage import HandEye, load_hand_eye, require_match
from cell.camera import LiveCamera
from cell.devices import ArmInfo, ArmState, CameraInfo
from cell.equipment import Equipment
from cell.errors import (
    AcknowledgeRequiredError,
    CalibrationError,
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

State = Literal["not_ready", "ready", "busy", "fault"]

FAULTS = (ProtectiveStopError, EmergencyStopError, RobotLostError, MotionError)
"""After these nobody but a person at the cell knows how the arm stands: they must be acknowledged."""

TURN_S = 1.0
"""How long a method waits for the arm and the camera; the watch has them for a moment only."""
WATCH_S = 0.5
"""How often an idle arm is looked at."""


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


class Cell:
    """Connects, watches, scans and stops. Safe to use from any thread; `stop` waits for no other method."""

    def __init__(self, settings: CellSettings) -> None:
        """Touches no device: that is for `connect`."""
        self.settings = settings
        self._equipment = Equipment(settings)
        self._turn = threading.Lock()
        """Of using arm and camera."""
        self._status = CellStatus()
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
        with self._using():
            self._connect()
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
            if status.state != "ready":
                raise StoppedError(f"the scan did not begin: {status.reason}")
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
                self._after(scan.error)
                raise
            self._after(None)

    def stop(self) -> None:
        """Stops the arm, whatever goes on. The scan under way, if any, ends with StoppedError."""
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
            if status.state == "ready" and info is not None:
                arm.check_ready()
            else:
                info = arm.connect()
            seen = self._camera_info()
            state = arm.state()
            require_match(hand_eye, seen.device_id, info.serial)
        except HandEyeError as error:
            self._after(unfit := CalibrationError(str(error)))
            raise unfit from error
        except CellError as error:
            self._after(error)
            raise
        self._status = replace(
            status, state="ready", reason=None, slug=None, arm=info, arm_state=state, camera=seen, hand_eye=hand_eye
        )

    def _calibration(self) -> HandEye:
        settings, world = self.settings.hand_eye, self._equipment.world
        if settings.file is None:
            if world is None:
                raise CalibrationError("the configuration lacks hand_eye.file: calibrate, and name the file there")
            T_flange_camera = world.told_T_flange_camera
            return HandEye(T_flange_camera, None, None, None, hashlib.sha256(T_flange_camera.tobytes()).hexdigest())
        try:
            return load_hand_eye(settings.file, settings.max_age_days)
        except HandEyeError as error:
            raise CalibrationError(str(error)) from error

    def _unchanged(self, used: HandEye) -> Callable[[], None]:
        def check() -> None:
            if self._calibration().sha256 != used.sha256:
                raise CalibrationError(
                    "the hand-eye calibration was changed during the scan: its views would not fit together. Scan again"
                )

        return check

    def _for_views(self, views: int | None) -> CellSettings:
        if views is None:
            return self.settings
        least = min(views, self.settings.scan.min_views)
        scan = self.settings.scan.model_copy(update={"views": views, "min_views": least})
        return self.settings.model_copy(update={"scan": scan})

    @contextlib.contextmanager
    def _using(self) -> Iterator[None]:
        if self._closing.is_set() or not self._turn.acquire(timeout=TURN_S):
            raise CellBusyError("the arm is in use: wait for the end of the scan, or stop it")
        try:
            yield
        finally:
            self._turn.release()

    def _after(self, error: BaseException | None) -> None:
        """The state that follows from how something ended."""
        if error is None:
            self._set("ready", None, None)
        elif isinstance(error, FAULTS):
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
