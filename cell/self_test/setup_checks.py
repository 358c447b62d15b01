"""Checks of what arm and camera need together: the calibration, the table, and the viewpoints."""

from datetime import UTC, datetime

import numpy as np

from calibration.errors import HandEyeError
from calibration.storage.hand_eye_file import CHECK_ROTATION, camera_faces_arm_message, require_match
from cell.control.active_calibration import file_in_use, hand_eye_in_use
from cell.devices import View
from cell.errors import CalibrationError
from cell.planning.viewpoints import plan_viewpoints
from cell.self_test.camera_checks import AT_THIS_POSE, MIN_SHARE_IN_VIEW, TURN_IT
from cell.self_test.check_result import CheckContext, CheckResult, failed, ok
from cell.self_test.table_check import distance_factor, fit_table, share_in_view
from recognition.preprocessing.table_plane import MAX_HEIGHT_ERROR_M, MAX_TILT_RAD

MIN_TABLE_SHARE = 0.5
"""Smallest share of the table among the points near its height."""
SHOW_IT_ALL = "make x_m and y_m in [workspace] smaller, or let the camera look from farther off by camera.working_m"
HIDDEN_COSINE = float(np.cos(np.deg2rad(150.0)))
"""Cosine of the largest angle between the camera's view and the flange's z. Beyond it the arm hides the workspace: 20
to 82 % of the table in the views of a ur5e at 150 degrees, 55 to 100 % at 180 degrees."""
MISPLACED = 3.0
"""Multiple of the table offset that recognition can correct. Beyond it, the configured height is wrong."""


def calibration(context: CheckContext) -> CheckResult:
    """Check that there is a calibration of this camera and robot that is not too old."""
    name = "calibration"
    settings = context.settings.hand_eye
    try:
        hand_eye = hand_eye_in_use(settings, context.equipment.nominal_hand_eye)
        require_match(
            hand_eye,
            None if context.camera is None else context.camera.device_id,
            None if context.arm is None else context.arm.serial,
        )
    except (CalibrationError, HandEyeError) as error:
        return failed(name, [error])
    file, now = file_in_use(settings), datetime.now(UTC)
    if file is None:
        context.hand_eye = hand_eye
        return ok(name, "that of the simulated cell")
    context.hand_eye = hand_eye
    T = hand_eye.T_flange_camera
    message = f"{file}: the camera is {1000 * np.linalg.norm(T[:3, 3]):.0f} mm from the flange"
    if hand_eye.created is not None:
        message += f", measured {(now - hand_eye.created).total_seconds() / 86400:.1f} days ago"
    return ok(name, message, hand_eye.warnings)


def table(context: CheckContext) -> CheckResult:
    """Check that the table is seen where the configuration has it, from where the arm stands."""
    name, settings = "table", context.settings
    frame, state, hand_eye = context.frame, context.state, context.hand_eye
    assert frame is not None
    assert state is not None
    assert hand_eye is not None
    view = View(0, frame.depth, frame.depth_unit_m, frame.K, state.T_base_flange, hand_eye.T_flange_camera)
    height, width = frame.depth.shape
    share = share_in_view(view.T_base_camera, frame.K, (width, height), settings)
    if share < MIN_SHARE_IN_VIEW:
        return CheckResult(
            name, "skipped", f"the camera sees {100 * share:.0f} % of the workspace, {AT_THIS_POSE}", TURN_IT
        )
    seen = fit_table(view, settings)
    if seen is None or seen.share < MIN_TABLE_SHARE:
        return CheckResult(
            name,
            "failed",
            f"no plane is seen within 10 cm of mounting.table_z_m, {settings.mounting.table_z_m:g} m",
            "check mounting.table_z_m and the workspace, that the calibration is of this mounting, and that the table "
            "is neither covered nor mirroring",
        )
    tilt = f"{np.rad2deg(seen.tilt_rad):.2f} degrees"
    message = f"seen {1000 * seen.height_m:+.1f} mm from mounting.table_z_m and tilted by {tilt}"
    max_height_m = MAX_HEIGHT_ERROR_M * distance_factor(view, settings)
    off = max(abs(seen.height_m) / max_height_m, seen.tilt_rad / MAX_TILT_RAD)
    if off > MISPLACED:
        return CheckResult(
            name, "failed", message, "correct mounting.table_z_m; if it is right, calibrate the cell again"
        )
    if off > 1.0:
        advice = "measure mounting.table_z_m again; if it is right, calibrate the cell again"
        return ok(name, message, [f"that is more than recognition corrects in a view: {advice}"])
    return ok(name, message)


def viewpoints(context: CheckContext) -> CheckResult:
    """Check that enough viewpoints are reachable from where the arm stands, or from home if that is unknown."""
    name, least = "viewpoints", context.settings.scan.min_views
    assert context.hand_eye is not None
    T_flange_camera = context.hand_eye.T_flange_camera
    if T_flange_camera[2, 2] <= HIDDEN_COSINE:  # the planner does not check whether the arm is in the image
        message = f"{camera_faces_arm_message(T_flange_camera)}, so that the arm itself hides the workspace"
        return CheckResult(name, "failed", message, CHECK_ROTATION)
    q_rad = None if context.state is None else context.state.q_rad
    plan = plan_viewpoints(context.settings, T_flange_camera, q_rad)
    skipped = {viewpoint.index: viewpoint.reason for viewpoint in plan.viewpoints if viewpoint.reason is not None}
    start = "home" if q_rad is None else "where the arm stands"
    message = f"{plan.reachable} of {len(plan.viewpoints)} reached from {start}, planned in {plan.planning_s:.1f} s"
    unseen = [] if plan.unseen is None else [f"{plan.unseen}: {SHOW_IT_ALL}"]
    if not skipped:
        return ok(name, message, unseen)
    message += "; " + "; ".join(f"{index}: {reason}" for index, reason in skipped.items())
    advice = (
        "change x_m, y_m or top_m in [workspace] so that the arm reaches around it; `pointchain viewpoints --picture "
        "plan.png` shows it"
    )
    if plan.reachable < least:
        return CheckResult(name, "failed", f"{message}; scan.min_views is {least}", advice)
    if plan.unseen is not None:
        message, advice = f"{message}; {plan.unseen}", f"{advice}; {SHOW_IT_ALL}"
    return CheckResult(name, "warning", message, advice)
