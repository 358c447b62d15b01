"""The self-test of the arm, on virtual controllers with faults."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.arm.ur_arm import UrArm
from cell.config.arm_config import SimulatedArm, URArm
from cell.config.cell_config import CellSettings
from cell.errors import RobotUnreachableError
from cell.kinematics.ur_kinematics import forward
from cell.self_test import arm_checks
from cell.self_test.check_result import CheckResult
from cell.simulation.ur_controller.launcher import RunningController, start_controller
from tests.cell.loopback import free_host
from tests.cell.self_test.cells_to_check import (
    Q_RAD,
    grounds_for,
    real_cell,
    state_at,
    written_hand_eye,
)

pytestmark = pytest.mark.slow

MOTION = {"motion_start", "script_error", "program_killed"}


@pytest.fixture(scope="module")
def controller() -> Iterator[RunningController]:
    running = start_controller("ur5e", free_host(), q_rad=Q_RAD)
    yield running
    running.close()


@pytest.fixture
def robot(controller: RunningController) -> Iterator[RunningController]:
    """Return the same robot without a fault."""
    controller.admin.reset(Q_RAD)
    yield controller
    controller.admin.reset(Q_RAD)


@pytest.fixture
def hand_eye_file(tmp_path: Path) -> Path:
    return written_hand_eye(tmp_path)


def test_an_unknown_host_name_is_reported(hand_eye_file: Path) -> None:
    with pytest.raises(RobotUnreachableError, match=r"'no-such-robot\.invalid' is not known"):
        arm_checks.controller(grounds_for(real_cell("no-such-robot.invalid", hand_eye_file)))


def test_a_silent_controller_is_reported(robot: RunningController, hand_eye_file: Path) -> None:
    robot.admin.half_open()
    context = grounds_for(real_cell(robot.host, hand_eye_file))
    assert arm_checks.controller(context).outcome == "ok"
    before = time.monotonic()
    with pytest.raises(RobotUnreachableError, match="does not answer"):
        arm_checks.robot(context)
    assert time.monotonic() - before < 3.0


def robot_step(robot: RunningController, hand_eye_file: Path, **arm: object) -> CheckResult:
    context = grounds_for(real_cell(robot.host, hand_eye_file, **arm))
    assert arm_checks.controller(context).outcome == "ok"
    step = arm_checks.robot(context)
    assert (context.arm is None) == (step.outcome == "failed")
    return step


def test_a_ready_robot_passes(robot: RunningController, hand_eye_file: Path) -> None:
    step = robot_step(robot, hand_eye_file)
    assert (step.outcome, step.what_to_do) == ("ok", None)
    assert "running, safety normal, in remote control, no program" in step.message


@pytest.mark.parametrize(
    ("fault", "expected", "advice"),
    [
        ("local_mode", "the robot is in local mode", "switch it to remote control"),
        ("foreign_program", "another program (welding.urp) is on the robot, playing", "stop it at the pendant first"),
        ("power_off", "the robot's arm is not switched on (power off)", "release its brakes"),
        ("protective_stop", "the robot is in a protective stop", "look at the cell"),
        ("emergency_stop", "an emergency stop is pressed", "release the button"),
    ],
)
def test_a_robot_that_is_not_ready_is_reported_and_unchanged(
    robot: RunningController, hand_eye_file: Path, fault: str, expected: str, advice: str
) -> None:
    getattr(robot.admin, fault)()
    time.sleep(0.05)  # wait for the next cycles of the controller
    since = len(robot.admin.log())
    step = robot_step(robot, hand_eye_file)
    assert step.outcome == "failed"
    assert expected in step.message
    assert step.message.startswith("UR5, serial number "), "the robot is still identified"
    assert advice in (step.what_to_do or "")
    assert "script_upload" not in {event["kind"] for event in robot.admin.log()[since:]}


def test_all_problems_of_a_robot_are_reported_together(robot: RunningController, hand_eye_file: Path) -> None:
    robot.admin.local_mode()
    robot.admin.power_off()
    time.sleep(0.05)
    step = robot_step(robot, hand_eye_file, model="ur10e")
    for reason in ("the robot is a UR5, not 'ur10e' as arm.model says", "local mode", "not switched on"):
        assert reason in step.message
    assert step.what_to_do is not None
    assert step.what_to_do.count(";") >= 2


def test_the_software_version_is_checked() -> None:
    old = start_controller("ur3e", free_host(), software="5.20.1")
    try:
        context = grounds_for(CellSettings(arm=SimulatedArm(model="ur3e")))
        context.address = old.host
        step = arm_checks.robot(context)
    finally:
        old.close()
    assert step.outcome == "warning"
    assert "before 5.25.1 anybody in its network can send it commands" in step.message
    assert "update the robot's software" in (step.what_to_do or "")


def test_a_connection_gives_fresh_joint_angles(robot: RunningController, hand_eye_file: Path) -> None:
    context = grounds_for(real_cell(robot.host, hand_eye_file))
    try:
        step = arm_checks.connection(context)
    finally:
        context.equipment.close()
    assert step.outcome == "ok"
    assert "17.2, -97.4, 80.2, -74.5, -85.9, 11.5 degrees" in step.message
    assert arm_checks.kinematics(context).outcome == "ok"
    assert not {event["kind"] for event in robot.admin.log()} & MOTION


@pytest.mark.parametrize(("off_m", "outcome"), [(0.0, "ok"), (0.003, "ok"), (0.008, "warning"), (0.05, "failed")])
def test_the_arm_model_is_compared_with_the_reported_pose(off_m: float, outcome: str) -> None:
    context = grounds_for(CellSettings())
    context.state = state_at(from_rotation_vector((off_m, 0, 0), (0, 0, 0)) @ forward("ur5e", Q_RAD))
    step = arm_checks.kinematics(context)
    assert step.outcome == outcome
    assert f"{1000 * off_m:.2f} mm and 0.00 degrees" in step.message


def test_another_program_that_drives_the_robot_is_reported(robot: RunningController, hand_eye_file: Path) -> None:
    ours = UrArm(URArm(kind="ur", host=robot.host), robot.host)
    try:
        ours.connect()
        step = robot_step(robot, hand_eye_file)
        assert ours.state().robot_mode == "running", "the other program still runs"
    finally:
        ours.close()
    assert "another program (rtde_control) is on the robot, playing" in step.message
    assert "end the software that drives the robot already" in (step.what_to_do or "")
