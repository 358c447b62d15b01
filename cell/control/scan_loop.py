"""The scan loop: move, settle, read the flange pose, capture, record, next."""

import contextlib
import contextvars
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, rotation_angle
from cell.devices import Arm, ArmState, Camera, View
from cell.errors import BadFrameError, CameraLostError, MissingViewsError, RobotNotReadyError
from cell.planning.viewpoints import ViewpointPlan

STILL_M, STILL_RAD = 0.0002, 0.0005
"""The flange may have moved by no more between the start and the end of a look."""
START_RAD = 0.002
"""No joint may be further from where the way was planned from: only that way is free of collisions."""


class ScanListener(Protocol):
    """Who is told how a scan goes. What it raises ends the scan."""

    def moving(self, index: int) -> None:
        """The arm is about to move to viewpoint `index`: it moves when this returns."""
        ...

    def recorded(self, index: int) -> None:
        """The view is on the disk."""
        ...

    def missing(self, index: int, reason: str) -> None:
        """There is no such view, and why."""
        ...


class ViewWriter(Protocol):
    """What keeps the views, as a recording."""

    def write_view(self, view: View) -> View:
        """Gives back the view as it is kept, once it is on the disk."""
        ...


def missing_view(index: int, reason: str) -> str:
    """A missing view in words, as a warning of the model."""
    return f"view {index} is missing: {reason}"


@dataclass(frozen=True, eq=False)
class ScanMeans:
    """What a scan is done with."""

    arm: Arm
    camera: Camera
    T_flange_camera: NDArray[np.float64]
    settle_s: float
    """From the arm's rest to the first exposure that counts."""
    check: Callable[[], None]
    """Called before each move; raises what must end the scan, as a calibration that has changed."""
    picture: bool = False
    """Whether the views have a picture besides the depth."""


def take_views(
    means: ScanMeans, plan: ViewpointPlan, writer: ViewWriter, listener: ScanListener, min_views: int
) -> Iterator[View]:
    """The views of the planned viewpoints in the order of the plan, each on the disk when it is given out.

    A look that the camera fails is a missing view, and the scan goes on. The arm stays where the last view was taken.

    Raises:
        RobotNotReadyError: the arm is not where the plan begins.
        CellError: whatever the arm's `move` and `means.check` raise: the scan ends there.
        MissingViewsError: the camera gave fewer than `min_views`.
        RecordingError, OSError: a view cannot be written.
    """
    for viewpoint in plan.viewpoints:
        if viewpoint.reason is not None:
            listener.missing(viewpoint.index, viewpoint.reason)
    if np.abs(means.arm.state().q_rad - plan.start_q_rad).max() > START_RAD:
        raise RobotNotReadyError("the arm was moved after its way was planned: begin anew")
    taken, failed = 0, ""
    for leg in plan.legs:
        if leg.view is None:
            continue
        means.check()
        listener.moving(leg.view)
        at_rest = _follow(means.arm, leg.waypoints_rad)
        try:
            view = _look(means, leg.view, at_rest)
        except (CameraLostError, BadFrameError) as error:
            failed = str(error)
            listener.missing(leg.view, failed)
            continue
        view = writer.write_view(view)
        listener.recorded(leg.view)
        taken += 1
        yield view
    if taken < min_views:
        raise MissingViewsError(f"only {taken} views were taken, {min_views} are needed; the last failure: {failed}")


def go_home(arm: Arm, plan: ViewpointPlan) -> None:
    """Moves the arm from the last viewpoint home. Raises what `arm.move` does."""
    for leg in plan.legs:
        if leg.view is None:
            _follow(arm, leg.waypoints_rad)


def _follow(arm: Arm, waypoints_rad: NDArray[np.float64]) -> ArmState:
    states = [arm.move(q_rad) for q_rad in waypoints_rad]
    return states[-1]


def _look(means: ScanMeans, index: int, at_rest: ArmState) -> View:
    frame = means.camera.capture(time.monotonic() + means.settle_s, means.picture)
    # Read again: somebody may have leant against the arm, or it may still have swung.
    T_base_flange = means.arm.state().T_base_flange
    moved = inverse(at_rest.T_base_flange) @ T_base_flange
    if np.linalg.norm(moved[:3, 3]) > STILL_M or rotation_angle(moved) > STILL_RAD:
        raise BadFrameError(
            f"the arm moved by {np.linalg.norm(moved[:3, 3]) * 1000:.1f} mm while the camera looked: "
            "it must be free of contact and its brakes and mounting firm"
        )
    return View(
        index=index,
        depth=frame.depth,
        depth_unit_m=frame.depth_unit_m,
        K=frame.K,
        T_base_flange=T_base_flange,
        T_flange_camera=means.T_flange_camera,
        stamp_s=frame.stamp_s,
        colour_jpeg=frame.colour_jpeg,
        image=frame.image,
    )


class BackgroundScan:
    """A scan whose arm moves in a thread of its own, while whoever iterates over it works on the views.

    It begins with `start`. Iterating ends with the last view; the arm then goes home by itself.
    """

    def __init__(
        self,
        means: ScanMeans,
        plan: ViewpointPlan,
        writer: ViewWriter,
        listener: ScanListener,
        min_views: int,
        going_home: Callable[[], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        """`going_home` is called when the last view is taken, `failed` when the arm has ended moving and something went
        wrong. Neither may wait."""
        self._means, self._plan, self._going_home, self._failed = means, plan, going_home, failed
        self._taking_error: BaseException | None = None
        self._home_error: BaseException | None = None
        self._views: queue.SimpleQueue[View | None] = queue.SimpleQueue()
        taking = take_views(means, plan, writer, listener, min_views)
        self._ended = threading.Event()
        """Not the thread's own: a signal that interrupts who joins a thread makes it look ended."""
        self._ended.set()
        # In the context of whoever begins it: what the log says of whose scan a line is.
        run = contextvars.copy_context().run
        self._thread = threading.Thread(target=run, args=(self._run, taking), name="motion", daemon=True)

    def start(self) -> None:
        """The arm may move from here on, even when this raises."""
        self._ended.clear()
        try:
            self._thread.start()
        except RuntimeError:  # there cannot be another thread
            self._ended.set()
            raise

    @property
    def at_work(self) -> bool:
        """The arm may move."""
        return not self._ended.is_set()

    @property
    def error(self) -> BaseException | None:
        """What ended it, if it was no good end."""
        return self._taking_error or self._home_error

    def __iter__(self) -> Iterator[View]:
        """The views as they are taken, each once; iterating again goes on where it was left.

        Raises what ended the scan before its last view.
        """
        while (view := self._views.get()) is not None:
            yield view
        self._views.put(None)  # for whoever iterates again
        if self._taking_error is not None:
            raise self._taking_error

    def wait(self) -> None:
        """Returns when the arm is home. Raises what went wrong, on the way home too."""
        self.join()
        if self.error is not None:
            raise self.error

    def join(self) -> None:
        """Returns when the arm has ended moving for good."""
        self._ended.wait()

    def _run(self, taking: Iterator[View]) -> None:
        try:
            self._take(taking)
            # What went wrong on the way home is worse than too few views before it: it may be a fault.
            error = self._home_error or self._taking_error
            if error is not None:
                self._failed(error)
        finally:
            self._ended.set()

    def _take(self, taking: Iterator[View]) -> None:
        try:
            for view in taking:
                self._views.put(view)
        except Exception as error:  # noqa: BLE001 (told to whoever iterates or waits)
            self._taking_error = error
        self._views.put(None)
        if not isinstance(self._taking_error, MissingViewsError | None):
            return  # the arm stays where it is; where too few views were all, it is well
        try:
            self._going_home()
            go_home(self._means.arm, self._plan)
        except Exception as error:  # noqa: BLE001 (told by `wait`)
            self._home_error = error


@contextlib.contextmanager
def attended(scan: BackgroundScan, stop: Callable[[], None]) -> Iterator[None]:
    """Starts the scan before the body. Left by an exception, an arm that may still move is stopped by `stop`; left in
    order, it is waited for until it is home. Raises what the scan does."""
    try:
        scan.start()
        yield
        scan.wait()
    except BaseException as error:
        # The scan's own errors leave the arm still, or on its way home.
        if error is not scan.error and scan.at_work:
            stop()
        try:
            scan.join()
        except BaseException:  # whoever waits is interrupted: the arm must not go on alone
            stop()
            scan.join()
            raise
        raise
