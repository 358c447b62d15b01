"""Preparation of a scan, a calibration or a verification: connect, plan, check. The arm does not move."""

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.input_checks.observations import MIN_VIEWS
from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.config.cell_config import CellSettings
from cell.config.scan_views import Views
from cell.control.active_calibration import (
    hand_eye_in_use,
    initial_guess,
    require_own_devices,
    verifiable_hand_eye,
)
from cell.control.equipment import Equipment
from cell.control.prepared import PreparedCalibration, PreparedScan, PreparedVerification
from cell.control.scan_planner import ScanPlanner
from cell.control.status import SharedStatus
from cell.control.stop_requests import StopRequests
from cell.devices import ArmInfo, CameraInfo
from cell.errors import CalibrationError, CameraLostError, CellError, StoppedError
from cell.planning.calibration_poses import plan_calibration, plan_verification
from cell.planning.expected_duration import expected_duration
from cell.planning.viewpoints import ViewpointPlan, require_enough
from cell.recording.header import RecordingHeader
from recognition.early_end.view_sufficiency import MIN_SUFFICIENT_VIEWS

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Connected:
    """Devices that answered, and the calibration that they are used with."""

    arm: ArmInfo
    """Connected arm."""
    camera: CameraInfo
    """Connected camera."""
    hand_eye: HandEye | None
    """Calibration of this camera and robot, or None where none is needed."""


class Preparation:
    """Connect arm and camera and plan their tour. It belongs to the thread that uses the equipment."""

    def __init__(self, settings: CellSettings, equipment: Equipment, status: SharedStatus, stops: StopRequests) -> None:
        self._settings, self._equipment, self._status, self._stops = settings, equipment, status, stops
        self._planner = ScanPlanner(settings)

    def scan(self, views: Views | None, requested_at: float) -> PreparedScan:
        """Prepare a scan, as `Cell.prepare_scan` says."""
        self._stops.raise_if_stopped_since(requested_at)  # before connecting: a stale request must not connect
        started_at = time.monotonic()
        self._equipment.lay_board(None)
        connected = self.connect_for_scan(views)
        hand_eye = connected.hand_eye
        assert hand_eye is not None
        connected_at = time.monotonic()
        plan = self.plan_scan(views, hand_eye)
        planned_at = time.monotonic()
        settings = self._settings.for_views(views)
        scan = settings.scan
        require_enough(plan, scan.min_views)
        self._stops.raise_if_stopped_since(requested_at)
        may_end_after = max(scan.min_views, MIN_SUFFICIENT_VIEWS) if scan.views == "auto" else None
        return PreparedScan(
            plan,
            hand_eye,
            requested_at,
            scan.min_views,
            replace(self._recording_header(hand_eye, connected), views_as_needed=scan.views == "auto"),
            connect_s=connected_at - started_at,
            plan_s=planned_at - connected_at,
            expected=expected_duration(plan, settings, may_end_after),
            expected_with_all=expected_duration(plan, settings),
            may_end_after=may_end_after,
        )

    def check_scan(self, requested_at: float) -> None:
        """Check what is known without a device, as `Cell.check_scan` says. Any thread may call this."""
        self._status.raise_if_fault()
        self._stops.raise_if_stopped_since(requested_at)
        status = self._status.now
        try:
            hand_eye = self.active_hand_eye()
            if status.state in ("ready", "busy") and status.camera is not None and status.arm is not None:
                require_own_devices(hand_eye, status.camera.device_id, status.arm.serial)
        except CalibrationError as error:
            self._status.leave_ready(error.slug, str(error))
            raise

    def calibration(self, board: Board, poses: int, held_out: int, requested_at: float) -> PreparedCalibration:
        """Prepare a calibration, as `Cell.prepare_calibration` says."""
        guess = initial_guess(self._settings.hand_eye, self._equipment.nominal_hand_eye)
        self._stops.raise_if_stopped_since(requested_at)
        self._equipment.lay_board(board)
        connected = self.connect(None)
        camera_id, robot_serial = connected.camera.device_id, connected.arm.serial
        with self._unready_if_failed():
            _require_images(connected.camera)
            hand_eye = guess.choose(camera_id, robot_serial)
            plan = plan_calibration(self._settings, board, hand_eye.T_flange_camera, self._q_rad, poses, held_out)
            self._stops.raise_if_stopped_since(requested_at)
        return PreparedCalibration(plan, hand_eye, requested_at, MIN_VIEWS, board, camera_id, robot_serial)

    def verification(self, requested_at: float) -> PreparedVerification:
        """Prepare a verification, as `Cell.prepare_verification` says."""
        hand_eye = verifiable_hand_eye(self._settings.hand_eye)
        board = hand_eye.board
        assert board is not None  # `verifiable_hand_eye` requires it
        self._stops.raise_if_stopped_since(requested_at)
        self._equipment.lay_board(board)
        connected = self.connect(lambda: hand_eye)
        with self._unready_if_failed():
            _require_images(connected.camera)
            plan = plan_verification(self._settings, board, hand_eye.T_flange_camera, self._q_rad)
            self._stops.raise_if_stopped_since(requested_at)
        ids = connected.camera.device_id, connected.arm.serial
        return PreparedVerification(plan, hand_eye, requested_at, len(plan.viewpoints), board, *ids)

    def connect_for_scan(self, views: Views | None = None) -> Connected:
        """Connect, as `connect` does, while the groundwork of the plan is laid.

        Args:
            views: Number of viewpoints or `auto`, or None for the configured value.
        """

        def load_hand_eye() -> HandEye:
            hand_eye = self.active_hand_eye()
            self._planner.prepare(views, hand_eye.T_flange_camera)
            return hand_eye

        return self.connect(load_hand_eye)

    def connect(self, load_hand_eye: Callable[[], HandEye] | None) -> Connected:
        """Connect arm and camera, unless they are connected.

        Args:
            load_hand_eye: Loads the calibration, which must be of this camera and robot. None means that no calibration
                is needed.

        Raises:
            AcknowledgeRequiredError: A fault has not been acknowledged.
            CellError: Arm, camera or calibration cannot be used.
            StoppedError: A stop was requested meanwhile.
        """
        self._status.raise_if_fault()
        status, started_at = self._status.now, time.monotonic()
        if status.state != "ready":
            self._status.change(reason="arm and camera are being connected: nothing moves")
        try:
            hand_eye = None if load_hand_eye is None else load_hand_eye()
            arm = status.arm if status.state == "ready" and self._is_still_ready() else None
            if arm is None:
                arm = self._equipment.arm.connect()
            self._stops.raise_if_stopped_since(started_at)  # the camera may take long
            camera = self._connect_camera()
            arm_state = self._equipment.arm.state()
            if hand_eye is not None:
                require_own_devices(hand_eye, camera.device_id, arm.serial)
        except Exception as error:
            self._status.set_outcome(error)
            raise
        self._status.set_connected(
            started_at, arm=arm, arm_state=arm_state, camera=camera, hand_eye=hand_eye or status.hand_eye
        )
        self._stops.raise_if_stopped_since(started_at)
        return Connected(arm, camera, hand_eye)

    def plan_scan(self, views: Views | None, hand_eye: HandEye) -> ViewpointPlan:
        """Plan the viewpoints of a scan from the arm's last known posture.

        Raises:
            ViewpointsError: No path leads from the arm's posture.
        """
        plan = self._planner.plan(views, hand_eye.T_flange_camera, self._q_rad)
        self._status.change(plan=plan)
        return plan

    def active_hand_eye(self) -> HandEye:
        """Load the active calibration from its file.

        Raises:
            CalibrationError: There is no usable calibration.
        """
        return hand_eye_in_use(self._settings.hand_eye, self._equipment.nominal_hand_eye)

    def require_usable(self) -> bool:
        """Make a ready cell not ready if a scan could not use its calibration. Return whether a scan could."""
        status = self._status.now
        try:
            require_own_devices(
                self.active_hand_eye(),
                None if status.camera is None else status.camera.device_id,
                None if status.arm is None else status.arm.serial,
            )
        except CalibrationError as error:
            self._status.leave_ready(error.slug, str(error))
            return False
        return True

    @contextlib.contextmanager
    def _unready_if_failed(self) -> Iterator[None]:
        """After a CellError of the body, make the cell not ready if a scan could not use its calibration."""
        try:
            yield
        except CellError:
            self.require_usable()
            raise

    @property
    def _q_rad(self) -> NDArray[np.float64] | None:
        """Last known joint angles (6,), or None."""
        state = self._equipment.latest_arm_state or self._status.now.arm_state
        return None if state is None else state.q_rad

    def _is_still_ready(self) -> bool:
        """Whether the arm that was ready can be moved. Raise the reason, unless the arm was stopped."""
        try:
            self._equipment.arm.check_ready()
        except StoppedError:
            return False
        return True

    def _connect_camera(self) -> CameraInfo:
        camera = self._equipment.camera
        if camera.connected:
            try:
                return camera.info()
            except CameraLostError as error:
                log.warning("%s; connecting the camera again", error)
        return camera.connect()

    def _recording_header(self, hand_eye: HandEye, connected: Connected) -> RecordingHeader:
        arm, camera = connected.arm, connected.camera
        world = self._equipment.world
        images = {} if world is None else world.provenance
        return RecordingHeader(
            depth_unit_m=camera.depth_unit_m,
            string_radius_m=None,
            T_flange_camera=hand_eye.T_flange_camera,
            table_z_m=self._settings.mounting.table_z_m,
            workspace_m=self._settings.workspace_m,
            simulated=self._settings.simulated,
            provenance={
                "camera": f"{camera.product} {camera.device_id}",
                "robot": f"{arm.model} {arm.serial}, software {arm.software}",
                "calibration_sha256": hand_eye.sha256,
                **images,
            },
        )


def _require_images(camera: CameraInfo) -> None:
    if not camera.has_images:
        raise CalibrationError(
            f"{camera.product} takes no intensity images, so it cannot see a calibration board: determine "
            "T_flange_camera in another way and write it to hand_eye.json in hand_eye.folder"
        )
