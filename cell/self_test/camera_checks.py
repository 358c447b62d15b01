"""Checks of the camera: the right one, healthy, with a usable depth image."""

import time

import numpy as np

from cell.camera.frame_averaging import NoFramesError
from cell.config.camera_optics import CameraOptics
from cell.devices import CameraInfo, Frame
from cell.errors import BadFrameError
from cell.self_test.check_result import CheckContext, CheckResult, failed, ok
from cell.self_test.table_check import share_in_view

HOT_C = 85.0
"""Largest normal temperature of the chip, degrees Celsius. Not far above, the chip slows down or switches off."""
MIN_MEASURED_SHARE = 0.3
"""Smallest share of measured pixels for a table in front of the camera."""
MIN_SHARE_IN_VIEW = 0.2
"""Smallest share of the workspace in the image for a camera that looks at the table."""
AT_THIS_POSE = "from where the arm stands"
TURN_IT = "to have that tested, move the arm by hand (freedrive) so that the camera looks at the workspace"
OLDEST_S, CLOCK_S = 2.0, 0.1
"""Largest age of a new frame, with its exposures and their median, and largest lead of its clock."""
OTHER_LENS_SHARE = 0.1
"""Largest relative difference between the focal lengths of one product."""
DEPTH_IMAGE = "depth image"


def camera(context: CheckContext) -> CheckResult:
    """Check that the camera is found and sends images."""
    context.camera = context.equipment.camera.connect()
    return camera_found(context.camera)


def camera_found(info: CameraInfo) -> CheckResult:
    """Return the result for what a camera reports about itself."""
    message = f"{info.product} {info.device_id}, {info.width}x{info.height}, {info.connection}"
    warnings = list(info.warnings)
    if info.temperature_c is not None:
        message += f", {info.temperature_c:.0f} degrees C"
        if info.temperature_c > HOT_C:
            warnings.append("that is hot: give the camera air, or screw it to metal")
    return ok("camera", message, warnings)


def frame(context: CheckContext) -> CheckResult:
    """Check that one capture gives a plausible and new depth image."""
    aside = looks_elsewhere(context)
    began_s = time.monotonic()
    try:
        got = context.equipment.camera.capture(began_s)
    except NoFramesError:
        raise
    except BadFrameError as error:
        if not aside:
            raise
        return CheckResult(
            DEPTH_IMAGE, "warning", f"{error}, but {AT_THIS_POSE} it does not look at the workspace", TURN_IT
        )
    step = depth_image(got, time.time() - got.stamp_s, context.settings.camera.optics, aside)
    if step.outcome != "failed":
        context.frame = got
    return step


def depth_image(got: Frame, age_s: float, optics: CameraOptics, aside: bool) -> CheckResult:
    """Return the result for one frame.

    Args:
        got: The frame.
        age_s: Time from its exposure to its arrival.
        optics: Nominal optics of the camera.
        aside: Whether the camera does not look at the workspace, so that the frame need not show much.
    """
    if not -CLOCK_S <= age_s <= OLDEST_S:
        return failed(
            DEPTH_IMAGE,
            [BadFrameError(f"the frame has an age of {age_s:.1f} s: restart the camera, its clock is wrong")],
        )
    measured = got.depth[got.depth > 0] * got.depth_unit_m
    share = measured.size / got.depth.size
    low, middle, high = np.quantile(measured, (0.05, 0.5, 0.95)) if measured.size else (0.0, 0.0, 0.0)
    message = (
        f"median of {got.exposures} exposures, {age_s:.1f} s old: {100 * share:.0f} % of the pixels measured, "
        f"{low:.2f} to {high:.2f} m away"
    )
    warnings = []
    if share < MIN_MEASURED_SHARE and not aside:
        warnings.append(
            "that is little: point the camera at the table; if it is, add light, or use a table with more texture"
        )
    elif measured.size and middle < optics.near_m:
        warnings.append(f"most is nearer than the {optics.near_m:.2f} m it can measure: clear what is in front of it")
    # focal lengths relative to the width do not depend on the resolution
    wide, planned = got.K[0, 0] / got.depth.shape[1], optics.K[0, 0] / optics.width
    if abs(wide / planned - 1) > OTHER_LENS_SHARE:
        angle, planned_angle = (np.rad2deg(2 * np.arctan(0.5 / f)) for f in (wide, planned))
        warnings.append(
            f"its field of view is {angle:.0f} degrees, and viewpoints are planned for {planned_angle:.0f}: set "
            "camera.product, and camera.working_m to the distances that suit it"
        )
    return ok(DEPTH_IMAGE, message, warnings)


def looks_elsewhere(context: CheckContext) -> bool:
    """Return whether the camera is known not to look at the workspace now."""
    if context.state is None or context.hand_eye is None:
        return False
    optics = context.settings.camera.optics
    T_base_camera = context.state.T_base_flange @ context.hand_eye.T_flange_camera
    size = optics.width, optics.height
    return share_in_view(T_base_camera, optics.K, size, context.settings) < MIN_SHARE_IN_VIEW
