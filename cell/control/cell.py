"""One cell: its arm, camera and calibration, and in which state they are."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.camera.camera import LiveCamera
from cell.config.cell_config import CellSettings
from cell.control.active_calibration import rough_hand_eyes, verifiable_hand_eye
from cell.control.cell_header import scan_header
from cell.control.equipment import Equipment
from cell.control.idle_monitor import IdleWatch
from cell.control.moving import Moving, Task
from cell.control.planner import Planning
from cell.control.preparing import Preparing
from cell.control.scan_loop import BackgroundScan, ScanListener, ViewWriter
from cell.control.status import CellStatus, KeptStatus, Listener
from cell.control.stop_requests import Stops
from cell.errors import (
    AcknowledgeRequiredError,
    CalibrationError,
    CellBusyError,
    NothingToAcknowledgeError,
)
from cell.planning.calibration_poses import HELD_OUT, POSES
from cell.planning.viewpoints import ViewpointPlan, require_enough
from cell.recording.header import RecordingHeader

TURN_S = 1.0
"""How long a method waits for the arm and the camera; the watch has them for a moment only."""
HOME_S = 20.0
"""Whoever asks for a scan waits so long for the arm of the last one to come home."""


class Cell:
    """Connects, watches, scans, calibrates and stops.

    Safe to use from any thread; `stop` and `give_up_connecting` wait for no other method.
    """

    def __init__(self, settings: CellSettings) -> None:
        """Touches no device: that is for `connect`."""
        self.settings = settings
        self._equipment = Equipment(settings)
        self._turn = threading.Lock()
        """Of using arm and camera."""
        self._status = KeptStatus()
        self._stops = Stops(self._status)
        self._planning = Planning(settings, self._equipment, lambda: self.status)
        self._preparing = Preparing(self._equipment, self._status, self._stops, self._planning)
        self._moves = Moving(settings, self._equipment, self._status, self._stops, self._preparing)
        self._closing = threading.Event()
        self._watch = IdleWatch(self._equipment, self._status, self._turn)

    @property
    def status(self) -> CellStatus:
        """The cell as last seen."""
        status, latest = self._status.now, self._equipment.latest_arm_state
        return status if latest is None else replace(status, arm_state=latest)

    def on_status(self, listener: Listener) -> None:
        """`listener` is told of each change of the status from now on, in order, by the thread that made it or another
        one that did. It must not wait: a stop may be behind it."""
        self._status.tell(listener)

    @property
    def controller_host(self) -> str | None:
        """Where the arm's controller listens; None before a simulated one was started."""
        return self._equipment.controller_address

    @property
    def camera(self) -> LiveCamera:
        """The camera; for one thread at a time, when no scan is under way."""
        return self._equipment.camera

    def hand_eye(self) -> HandEye:
        """The calibration in use, as its file is now; asks no device anything. Raises CalibrationError."""
        return self._planning.hand_eye()

    def connect(self) -> None:
        """Connects arm and camera, unless they are; nothing moves.

        Raises:
            AcknowledgeRequiredError: there was a fault that nobody has acknowledged.
            CellBusyError: a scan is under way.
            CellError: arm, camera or calibration cannot be used, with the reason.
            StoppedError: a stop came meanwhile.
        """
        with self._using():
            self._preparing.connect(self._planning.hand_eye)

    def plan(self, views: int | None = None) -> ViewpointPlan:
        """The viewpoints from where the arm stands, or stood last; asks no device anything, nothing moves.

        Raises:
            CalibrationError: without it nobody knows where the camera is.
            ViewpointsError: the arm stands where no path leads from.
        """
        plan = self._planning.scan(views)
        self._status.change(plan=plan)
        return plan

    def prepare(self, views: int | None = None, asked_s: float | None = None) -> ViewpointPlan:
        """Makes sure that a scan can be done, and plans it; connects first if need be. Nothing moves.

        `asked_s` is when it was asked for, by `time.monotonic()`, if not now.

        Raises: as `connect` and `plan`; ViewpointsError when too few viewpoints can be reached; StoppedError when a
        stop came since it was asked for.
        """

        def planned() -> ViewpointPlan:
            plan = self.plan(views)
            require_enough(plan, self.settings.for_views(views).scan.min_views)
            return plan

        return self._prepared(None, self._planning.hand_eye, planned, asked_s)

    def prepare_calibration(
        self, board: Board, poses: int = POSES, held_out: int = HELD_OUT, asked_s: float | None = None
    ) -> ViewpointPlan:
        """The same for a calibration with the board; no calibration is needed, but about where the camera is.

        `poses` are solved from, `held_out` more judge it. On a simulated cell the board is laid on the table.

        Raises: as `connect`; CalibrationError when nothing is known of the mounting, or a ruler tells another than the
        calibration in use; ViewpointsError when too few poses can be reached.
        """
        told = rough_hand_eyes(self.settings.hand_eye, self._equipment.world)
        return self._prepared(board, None, lambda: self._planning.calibration(board, told, poses, held_out), asked_s)

    def prepare_verification(self, asked_s: float | None = None) -> ViewpointPlan:
        """The same for two looks at the board of the calibration in use, however old that is.

        Raises: as `prepare_calibration`; CalibrationError too when the calibration does not tell of its board.
        """
        hand_eye = verifiable_hand_eye(self.settings.hand_eye)
        board = hand_eye.board
        assert board is not None
        return self._prepared(board, lambda: hand_eye, lambda: self._planning.verification(board, hand_eye), asked_s)

    def made_with(self, plan: ViewpointPlan) -> HandEye:
        """The calibration, maybe a rough one, by which a plan to calibrate or verify was made.

        Raises:
            CalibrationError: it is not the last plan of these.
        """
        return self._planning.basis(plan).hand_eye

    def calibration_changed(self) -> None:
        """Another calibration is in use since a moment ago; asks no device anything."""
        if self._preparing.require_usable() and self._status.now.slug == CalibrationError.slug:
            reason = "another calibration is in use now: connect, or start a live scan"
            self._status.change(slug="not-connected", reason=reason)

    def header(self, radius_m: float | None) -> RecordingHeader:
        """Of the recording of a scan that was prepared; `radius_m` None: not known."""
        return scan_header(self._status.now, self.settings, self._equipment.camera.depth_unit_m, radius_m)

    def scanning(
        self, plan: ViewpointPlan, writer: ViewWriter, listener: ScanListener
    ) -> contextlib.AbstractContextManager[BackgroundScan]:
        """A scan by `plan`, as `prepare` gave it; it has begun when the body is entered.

        Left by an exception, an arm that may still move is stopped; left in order, it is waited for until it is home.
        Raises what the scan does, CellBusyError, and StoppedError when a stop came since it was asked for.
        """
        least = min(self.settings.scan.min_views, len(plan.viewpoints))
        return self._moving(plan, writer, listener, Task(least, self._planning.scan_basis))

    def calibrating(
        self, plan: ViewpointPlan, writer: ViewWriter, listener: ScanListener, least: int
    ) -> contextlib.AbstractContextManager[BackgroundScan]:
        """The same by a plan of `prepare_calibration` or `prepare_verification`: the views have pictures, and their
        `T_flange_camera` is the one that the plan was made with. With fewer than `least` views it raises
        MissingViewsError. Afterwards the cell is ready only if there is a calibration that it can use.
        """
        return self._moving(plan, writer, listener, Task(least, lambda: self._planning.basis(plan)))

    def stop(self) -> None:
        """Stops the arm, whatever goes on. The scan under way or being prepared, if any, ends with StoppedError."""
        self._stops.note()
        self._equipment.stop()
        self._stops.told()

    def refuse_earlier(self) -> None:
        """Nothing begins to move that was asked for by now; what moves already goes on."""
        self._stops.note()

    def wait_while_busy(self, seconds: float) -> None:
        """Returns when the arm has ended what it was at, as behind a stop, or after so long."""
        self._status.wait_while_busy(seconds)

    def release(self, asked_s: float | None = None) -> None:
        """Ends our program on the robot, so that another can move it; the camera stays connected. Nothing moves.

        Waits for an arm that is on its way home. The next `connect` or `prepare` takes the arm again. `asked_s` is when
        it was asked for, by `time.monotonic()`, if not now.

        Raises:
            AcknowledgeRequiredError: there was a fault that nobody has acknowledged.
            CellBusyError: a scan is under way.
            StoppedError: a stop came since it was asked for: the arm is not where it was expected, nor wanted to move.
        """
        asked_s = time.monotonic() if asked_s is None else asked_s
        with self._using(HOME_S):
            if self._status.now.state == "fault":
                raise AcknowledgeRequiredError(self._status.now.reason)
            self._stops.refuse_handing_over(asked_s)
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

    def restore_fault(self, slug: str, reason: str) -> None:
        """Before the first use: a fault that nobody has acknowledged since the cell was last used. Asks no device."""
        self._status.change(state="fault", slug=slug, reason=reason)

    def give_up_connecting(self) -> None:
        """Before `close`, for good: nobody waits any more for a camera that is not connected yet."""
        self._equipment.give_up_connecting()

    def close(self) -> None:
        """Stops the arm and lets everything go."""
        self._closing.set()
        self.give_up_connecting()
        if self._status.now.state == "busy":
            self._equipment.stop()
        self._watch.end()
        with self._turn:
            self._equipment.close()
            if self._status.now.state != "fault":  # that nobody has looked at: it is not over with this
                self._status.change(state="not_ready", slug="not-ready", reason="the service is ending")

    def _prepared(
        self,
        board: Board | None,
        calibration: Callable[[], HandEye] | None,
        planned: Callable[[], ViewpointPlan],
        asked_s: float | None,
    ) -> ViewpointPlan:
        asked_s = time.monotonic() if asked_s is None else asked_s  # a stop counts that comes before this has its turn
        with self._using(HOME_S):
            self._stops.refuse_stale(asked_s)  # nobody connects behind a stop for what it refuses
            return self._preparing.prepare(board, calibration, planned, asked_s)

    @contextlib.contextmanager
    def _moving(
        self, plan: ViewpointPlan, writer: ViewWriter, listener: ScanListener, task: Task
    ) -> Iterator[BackgroundScan]:
        with self._using(), self._moves.under_way(plan, writer, listener, task) as scan:
            yield scan

    @contextlib.contextmanager
    def _using(self, wait_s: float = TURN_S) -> Iterator[None]:
        if self._closing.is_set() or not self._turn.acquire(timeout=wait_s):
            raise CellBusyError("the arm is in use: wait for the end of the scan or calibration, or stop it")
        try:
            if self._closing.is_set():
                raise CellBusyError("the service is ending")
            yield
        finally:
            self._turn.release()
