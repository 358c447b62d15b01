"""Self-test of a cell, step by step. Each step says what was found and what to do. The arm does not move."""

from collections.abc import Callable, Iterator

from cell.config.arm_config import SimulatedArm
from cell.config.cell_config import CellSettings
from cell.control.equipment import Equipment
from cell.devices import InvalidViewError
from cell.errors import CellError
from cell.self_test import arm_checks, camera_checks, depth_quality, exposure_check, grasp_check, setup_checks
from cell.self_test.check_result import CheckContext, CheckResult, failed, ok

REDUCED_M_S = 0.25
"""Largest flange speed near people, which safety standards call reduced speed."""

NEEDS = {
    "address": "the controller",
    "arm": "a robot that may be driven",
    "state": "the connection to the arm",
    "camera": "the camera",
    "frame": "a depth image",
    "burst": "exposures that show the table",
    "hand_eye": "the hand-eye calibration",
}
"""Descriptions of what a later step may need, by the name in `CheckContext`."""


def check_cell(settings: CellSettings) -> Iterator[CheckResult]:
    """Yield the result of each check when it is done. A check without its preconditions is skipped.

    The arm is connected and released, which ends no program of another client. The arm does not move. A simulated cell
    is started for the test.
    """
    context = CheckContext(settings, Equipment(settings))
    steps: list[tuple[str, tuple[str, ...], Callable[[CheckContext], CheckResult]]] = [
        ("configuration", (), _configuration),
        ("controller", (), arm_checks.controller),
        ("robot", ("address",), arm_checks.robot),
        ("connection", ("arm",), arm_checks.connection),
        ("arm model", ("state",), arm_checks.kinematics),
        ("camera", (), camera_checks.camera),
        ("calibration", (), setup_checks.calibration),
        ("depth image", ("camera",), camera_checks.frame),
        (exposure_check.NAME, ("frame",), exposure_check.exposures),
        (depth_quality.NAME, ("frame", "burst"), depth_quality.depth_quality),
        ("table", ("frame", "state", "hand_eye"), setup_checks.table),
        ("viewpoints", ("hand_eye",), setup_checks.viewpoints),
        (grasp_check.NAME, ("hand_eye",), grasp_check.grasps),
    ]
    try:
        for name, needs, test in steps:
            missing = [NEEDS[need] for need in needs if getattr(context, need) is None]
            if missing:
                yield CheckResult(name, "skipped", f"it needs {' and '.join(missing)}")
                continue
            try:
                step = test(context)
            except (CellError, InvalidViewError) as error:
                step = failed(name, [error])
            yield step
    finally:
        context.equipment.close()


def _configuration(context: CheckContext) -> CheckResult:
    settings = context.settings
    arm, camera, scan = settings.arm, settings.camera, settings.scan
    parts = [
        f"{'simulated ' if isinstance(arm, SimulatedArm) else ''}{arm.model}"
        + (f" at {arm.host}" if arm.host is not None else ""),
        camera.summary,
        "workspace " + " x ".join(f"{low:g}..{high:g}" for low, high in settings.workspace_m) + " m",
        f"{scan.views} views, {scan.min_views} at least",
        f"up to {arm.speed_rad_s:g} rad/s and {arm.flange_speed_m_s:g} m/s",
    ]
    warnings = []
    if arm.flange_speed_m_s > REDUCED_M_S and not isinstance(arm, SimulatedArm):
        warnings.append(
            f"arm.flange_speed_m_s is above {REDUCED_M_S:g}: keep people out of the cell by other means, the software "
            "is no safeguard at any speed"
        )
    return ok("configuration", ", ".join(parts), warnings)
