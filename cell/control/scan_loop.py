"""The scan loop: move, settle, read the flange pose, capture, record, next."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, rotation_angle
from cell.control.early_end import EarlyEnd
from cell.control.progress import MissingView, ProgressListener, ViewTiming
from cell.devices import Arm, ArmState, Camera, View
from cell.errors import BadFrameError, CameraLostError, MissingViewsError, RobotNotReadyError
from cell.planning.viewpoints import ViewpointPlan

STILL_M, STILL_RAD = 0.0002, 0.0005
"""Largest motion of the flange between the start and the end of a capture."""
START_RAD = 0.002
"""Largest distance of a joint from the start of the plan. Only the planned path is free of collisions."""


class ViewWriter(Protocol):
    """Stores the views, for example in a recording."""

    def write_view(self, view: View) -> View:
        """Write the view to the disk and return it as it was written."""
        ...


@dataclass(frozen=True, eq=False)
class ScanContext:
    """Devices and settings of a scan."""

    arm: Arm
    """Connected arm."""
    camera: Camera
    """Connected camera on the flange."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) hand-eye calibration that each view gets."""
    settle_s: float
    """Waiting time between the end of a move and the first exposure."""
    check: Callable[[], None]
    """Called before each move. It raises the error that ends the scan, for example because the calibration changed."""
    with_image: bool = False
    """Whether each view has an `image` for a calibration."""


def take_views(
    context: ScanContext,
    plan: ViewpointPlan,
    writer: ViewWriter,
    listener: ProgressListener,
    min_views: int,
    early_end: EarlyEnd,
) -> Iterator[View | MissingView]:
    """Yield the views of the planned viewpoints in the order of the plan, each when it is on the disk.

    A viewpoint that the arm cannot reach, or at which the camera fails, gives a MissingView, and the scan continues.
    The arm stays at the last viewpoint.

    Args:
        context: Devices and settings.
        plan: Viewpoints and path.
        writer: Writes each view to the disk.
        listener: Receives the progress.
        min_views: Smallest number of views.
        early_end: Decides at a viewpoint whether the scan ends there.

    Raises:
        RobotNotReadyError: The arm is not at the start of the plan.
        CellError: An error of the arm's `move` or of `context.check`, which ends the scan.
        MissingViewsError: The camera gave fewer than `min_views` views.
        RecordingError: A view cannot be recorded.
        OSError: A view cannot be written.
    """
    for viewpoint in plan.viewpoints:
        if viewpoint.reason is not None:
            listener.missing(viewpoint.index, viewpoint.reason)
            yield MissingView(viewpoint.index, viewpoint.reason)
    if np.abs(context.arm.state().q_rad - plan.start_q_rad).max() > START_RAD:
        raise RobotNotReadyError("the arm was moved after its path was planned: start again")
    taken, failure = 0, ""
    for leg, following in zip(plan.legs, [*plan.legs[1:], None], strict=True):
        if leg.view is None:
            continue
        context.check()
        listener.moving(leg.view)
        moves_at = time.monotonic()
        at_rest = _follow(context.arm, leg.waypoints_rad)
        arrived_at = time.monotonic()
        try:
            view = _capture(context, leg.view, at_rest)
        except (CameraLostError, BadFrameError) as error:
            failure = str(error)
            listener.missing(leg.view, failure)
            yield MissingView(leg.view, failure)
            continue
        captured_at = time.monotonic()
        view = writer.write_view(view)
        exposure_s = captured_at - arrived_at - context.settle_s
        listener.recorded(leg.view, ViewTiming(arrived_at - moves_at, context.settle_s, exposure_s))
        taken += 1
        yield view
        is_last = following is None or following.view is None
        if not is_last and early_end.wait(taken):
            break
    if taken < min_views:
        raise MissingViewsError(f"only {taken} views were taken, {min_views} are needed; the last failure: {failure}")


def return_home(arm: Arm, plan: ViewpointPlan) -> None:
    """Move the arm from the viewpoint at which it stands home. Raise the errors of `arm.move`."""
    q_rad = arm.state().q_rad
    to_views = [leg for leg in plan.legs if leg.view is not None]
    here = min(to_views, key=lambda leg: float(np.abs(leg.waypoints_rad[-1] - q_rad).max()))
    _follow(arm, here.home_waypoints_rad)


def _follow(arm: Arm, waypoints_rad: NDArray[np.float64]) -> ArmState:
    state = arm.move(waypoints_rad[0])
    for q_rad in waypoints_rad[1:]:
        state = arm.move(q_rad)
    return state


def _capture(context: ScanContext, index: int, at_rest: ArmState) -> View:
    frame = context.camera.capture(time.monotonic() + context.settle_s, context.with_image)
    if context.with_image and frame.image is None:
        raise BadFrameError("the camera's driver returned no intensity image, although one was requested")
    # The pose is read again: a person may have pushed the arm, or the arm may have swung.
    T_base_flange = context.arm.state().T_base_flange
    moved = inverse(at_rest.T_base_flange) @ T_base_flange
    if np.linalg.norm(moved[:3, 3]) > STILL_M or rotation_angle(moved) > STILL_RAD:
        raise BadFrameError(
            f"the arm moved by {np.linalg.norm(moved[:3, 3]) * 1000:.1f} mm while the camera captured: "
            "it must be free of contact and its brakes and mounting firm"
        )
    return View(
        index=index,
        depth=frame.depth,
        depth_unit_m=frame.depth_unit_m,
        K=frame.K,
        T_base_flange=T_base_flange,
        T_flange_camera=context.T_flange_camera,
        stamp_s=frame.stamp_s,
        colour_jpeg=frame.colour_jpeg,
        image=frame.image,
        intensity=frame.intensity,
    )
