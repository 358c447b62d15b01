"""Checks of the arm, from the network to fresh joint angles. The arm does not move."""

import time

import numpy as np

from calibration.geometry.transforms import inverse, rotation_angle
from cell.arm import dashboard, preflight
from cell.config.arm_config import SimulatedArm
from cell.errors import RobotLostError, RobotUnreachableError
from cell.kinematics.ur_kinematics import forward
from cell.self_test.check_result import CheckContext, CheckResult, failed, ok

PORTS = {
    preflight.RTDE_PORT: "RTDE, which reports the joint angles",
    preflight.SCRIPT_PORT: "the script interface",
    dashboard.PORT: "the dashboard server",
}
PORT_S = 0.8
"""Timeout of a connection to one port. All ports together take less than 3 s."""
PATCHED = (5, 25, 1)
"""First software version that does not accept dashboard commands from anybody in the network."""
APART_S = 0.1
"""Time between two states of the arm whose clocks must differ."""
STALE_S = 0.1
"""Largest age of fresh joint angles. The controller sends them every 2 ms."""
CALIBRATED_M, CALIBRATED_RAD = 0.005, 0.01
"""Largest difference between the calibrated and the nominal flange pose of a normal arm."""
OTHER_ARM_M, OTHER_ARM_RAD = 0.02, 0.05
"""Largest difference for an arm of this model at all."""


def controller(context: CheckContext) -> CheckResult:
    """Check that the address of the controller is known and its ports answer. A simulated controller is started."""
    name = "controller"
    arm = context.settings.arm
    address = context.equipment.arm.host if isinstance(arm, SimulatedArm) else preflight.resolve_host(arm.host)
    errors: dict[int, RobotUnreachableError] = {}
    for port in PORTS:
        try:
            dashboard.connected(address, port, time.monotonic() + PORT_S).close()
        except RobotUnreachableError as error:
            errors[port] = error
    if len(errors) == len(PORTS):
        return failed(name, list(errors.values())[:1])
    if errors:
        silent = " and ".join(f"{port} ({PORTS[port]})" for port in errors)
        return CheckResult(
            name,
            "failed",
            f"{address} answers, but not on port {silent}",
            "enable it at the pendant under Settings, Security, Services, and let the firewall pass it",
        )
    context.address = address
    return ok(name, f"{address} answers on ports {', '.join(map(str, sorted(PORTS)))}")


def robot(context: CheckContext) -> CheckResult:
    """Check by the dashboard which robot it is and whether it may be driven now."""
    name = "robot"
    assert context.address is not None
    with dashboard.Dashboard(context.address, time.monotonic() + preflight.PROBE_S) as link:
        info = preflight.read_identity(link)
        against = list(preflight.find_driving_errors(link, info, context.settings.arm.model))
        modes = f"{preflight.robot_mode(link)}, safety {preflight.safety_mode(link)}".replace("_", " ")
    message = f"{info.model}, serial number {info.serial}, software {info.software}, {modes}"
    if against:
        return failed(name, against, message)
    context.arm = info
    return ok(name, message + ", in remote control, no program", _software_warnings(info.software))


def connection(context: CheckContext) -> CheckResult:
    """Check that the real-time connection delivers fresh joint angles."""
    arm = context.equipment.arm
    arm.connect()
    before = arm.state()
    time.sleep(APART_S)
    state = arm.state()
    if not state.controller_s > before.controller_s or state.age_s > STALE_S:
        raise RobotLostError(
            f"the joint angles are {state.age_s:.2f} s old and do not change: check the network cable and switch, and "
            "that the controller is not overloaded"
        )
    context.state = state
    degrees = ", ".join(f"{angle:.1f}" for angle in np.rad2deg(state.q_rad))
    reduced = "the robot is in reduced mode: expect slower moves, or leave the zone that reduces it"
    warnings = [reduced] if state.safety_mode == "reduced" else []
    return ok("connection", f"joint angles {1000 * state.age_s:.0f} ms old: {degrees} degrees", warnings)


def kinematics(context: CheckContext) -> CheckResult:
    """Check that the reported flange pose is that of the configured arm model."""
    name = "arm model"
    state, model = context.state, context.settings.arm.model
    assert state is not None
    apart = inverse(forward(model, state.q_rad)) @ state.T_base_flange
    far_m, turned_rad = float(np.linalg.norm(apart[:3, 3])), rotation_angle(apart)
    message = (
        f"the flange is {1000 * far_m:.2f} mm and {np.rad2deg(turned_rad):.2f} degrees from that of a nominal {model}"
    )
    if far_m > OTHER_ARM_M or turned_rad > OTHER_ARM_RAD:
        return CheckResult(name, "failed", message, "set arm.model to the arm that stands there")
    if far_m > CALIBRATED_M or turned_rad > CALIBRATED_RAD:
        advice = "viewpoints are planned with the nominal arm: leave more room in mounting.clearance_m"
        return CheckResult(name, "warning", message + ", more than calibration usually makes", advice)
    return ok(name, message)


def _software_warnings(version: str) -> list[str]:
    numbers = tuple(int(part) for part in version.split(".") if part.isdigit())
    if numbers[:1] != (5,):
        return ["only e-Series software 5 is known to work: try each command with a hand on the emergency stop"]
    if numbers < PATCHED:
        return [
            "before 5.25.1 anybody in its network can send it commands: update the robot's software, and keep it in a "
            "network of its own"
        ]
    return []
