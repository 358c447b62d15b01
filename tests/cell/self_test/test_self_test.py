"""The self-test of the whole cell: findings, skipped steps with reasons, and no motion."""

import time
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

import pytest

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.errors import RobotNotReadyError
from cell.self_test.check_result import CheckResult, failed
from cell.self_test.self_test import check_cell
from cell.simulation.ur_controller.admin_client import AdminClient, ControllerGoneError
from cell.simulation.ur_controller.launcher import start_controller
from tests.cell.loopback import free_host
from tests.cell.self_test.cells_to_check import (
    real_cell,
    written_hand_eye,
)

pytestmark = pytest.mark.slow

MOTION = {"motion_start", "script_error", "program_killed"}


@pytest.fixture
def hand_eye_file(tmp_path: Path) -> Path:
    return written_hand_eye(tmp_path)


def test_a_whole_simulated_cell_passes_and_nothing_moves() -> None:
    host = free_host()
    steps, log = [], []
    settings = CellSettings(arm=SimulatedArm(host=host), camera=SimulatedCamera(image_cache_bytes=0))
    for step in check_cell(settings):
        steps.append(step)
        if step.name == "viewpoints":
            with closing(AdminClient(host)) as admin:
                log = admin.log()
    outcomes = {step.name: step.outcome for step in steps}
    expected = (
        "configuration, controller, robot, connection, arm model, camera, calibration, depth image, exposures, "
        "depth quality, table, viewpoints, grasps"
    )
    assert ", ".join(outcomes) == expected
    assert "failed" not in outcomes.values(), steps
    assert [outcomes[name] for name in ("controller", "robot", "connection", "arm model", "camera")] == ["ok"] * 5
    measured, quality = (step.figures for step in steps if step.figures is not None)
    assert outcomes["depth quality"] == "ok", steps
    assert quality["as_expected"]
    assert measured["configured_frame_rate"] == 30.0
    assert [median["exposures"] for median in measured["medians"]] == [1, 3, 5]
    kinds = {event["kind"] for event in log}
    assert "script_upload" in kinds, "the connection was really tested"
    assert not kinds & MOTION
    assert_gone(host)


def assert_gone(host: str) -> None:
    with closing(AdminClient(host)) as admin, pytest.raises(ControllerGoneError):
        admin.state()


def test_an_interrupted_self_test_leaves_no_process() -> None:
    host = free_host()
    steps = check_cell(CellSettings(arm=SimulatedArm(host=host), camera=SimulatedCamera(model="ideal")))
    assert isinstance(steps, Generator)
    assert next(step for step in steps if step.name == "controller").outcome == "ok"
    with closing(AdminClient(host)) as admin:
        admin.state()
    steps.close()
    assert_gone(host)


def test_a_missing_robot_and_camera_are_reported_in_time(hand_eye_file: Path) -> None:
    steps: dict[str, CheckResult] = {}
    took_s: dict[str, float] = {}
    before = time.monotonic()
    for step in check_cell(real_cell(free_host(), hand_eye_file)):
        steps[step.name] = step
        took_s[step.name] = time.monotonic() - before
        before = time.monotonic()
    assert steps["controller"].outcome == "failed"
    assert "no robot answers at 127." in steps["controller"].message
    assert "check arm.host" in (steps["controller"].what_to_do or "")
    assert steps["camera"].outcome == "failed"
    assert "no OAK camera" in steps["camera"].message
    assert "cable" in (steps["camera"].what_to_do or "")
    # The promised 3 s plus the import of the camera library, which takes long on a busy machine.
    assert took_s["controller"] < 3.0
    assert steps["robot"] == CheckResult("robot", "skipped", "it needs the controller")
    assert steps["connection"].message == "it needs a robot that may be driven"
    assert steps["table"].message == "it needs a depth image and the connection to the arm"
    assert steps["depth quality"].message == "it needs a depth image and exposures that show the table"
    assert steps["calibration"].outcome == "ok"
    assert "measured 3.0 days ago" in steps["calibration"].message
    assert steps["viewpoints"].message.startswith("8 of 8 reached from home")
    assert steps["grasps"].outcome == "ok"


def test_the_error_and_the_action_are_separate() -> None:
    step = failed("robot", [RobotNotReadyError("it is off: switch it on"), RobotNotReadyError("it is local")])
    assert step == CheckResult("robot", "failed", "it is off; it is local", "switch it on")


def test_a_used_address_is_reported() -> None:
    controller = start_controller("ur5e", free_host())
    try:
        steps = check_cell(CellSettings(arm=SimulatedArm(host=controller.host)))
        assert isinstance(steps, Generator)
        step = next(step for step in steps if step.name == "controller")
        steps.close()
    finally:
        controller.close()
    assert step.outcome == "failed"
    assert controller.host in step.message
