"""Requirements of the cell on a UR controller: `pytest -m ursim --host H`, or the virtual controller without `--host`.

The arm turns about its base from its present position by at most TURN_RAD, and back. The checks use the data and the
clock of the controller, received by an independent client.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from universal_robots_clients import dashboard_client

from cell.arm.ur_arm import UrArm
from cell.config.arm_config import ArmSettings
from cell.errors import MotionError, RobotNotReadyError, StoppedError
from cell.kinematics import ur_kinematics
from cell.process.child import Child
from tests.cell.arm.pendant import Pendant
from tests.cell.arm.virtual_arm import thread_of, until
from tests.cell.conformance.conftest import switch_on
from tests.cell.conformance.witness import Witness

pytestmark = [
    pytest.mark.ursim,
    pytest.mark.xdist_group("cell"),  # one at a time, because each test runs several busy processes
]

TURN_RAD = 0.8
AT_GOAL_RAD = 2e-3
STILL_S = 0.5
"""Limit from full speed to rest, seconds. 0.5 rad/s are at most 0.4 m/s at the flange, which 4 m/s2 stop in 0.1 s."""
REPEAT_M = 5e-4
"""Limit of the repeatability of the pose that the controller reports, metres."""


def turned(q_rad: NDArray[np.float64], by_rad: float) -> NDArray[np.float64]:
    return q_rad + [by_rad, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_connect_returns_the_arm_and_close_frees_the_robot(host: str, settings: ArmSettings, witness: Witness):
    arm = UrArm(settings, host)
    info = arm.connect()
    assert info.serial == dashboard_client.send_command(host, "get serial number", timeout=10.0)
    assert info.model == dashboard_client.send_command(host, "get robot model", timeout=10.0)
    assert info.software
    assert witness.program, "our program holds the robot"
    arm.close()
    until(lambda: not witness.program, 5.0)
    assert not witness.moving


def test_a_move_reaches_its_goal_and_returns_to_its_start(arm: UrArm, witness: Witness):
    before = arm.state()
    np.testing.assert_allclose(before.q_rad, witness.q_rad, atol=AT_GOAL_RAD)
    goal = turned(before.q_rad, TURN_RAD / 2)
    there = arm.move(goal)
    np.testing.assert_allclose(there.q_rad, goal, atol=AT_GOAL_RAD)
    np.testing.assert_allclose(witness.q_rad, goal, atol=AT_GOAL_RAD)
    assert not there.moving
    # The pose follows the calibration of the arm in the controller, and is that of the flange for any tool.
    T_nominal = ur_kinematics.forward(arm.settings.model, there.q_rad)
    np.testing.assert_allclose(there.T_base_flange, T_nominal, atol=0.02)
    back = arm.move(before.q_rad)
    np.testing.assert_allclose(back.T_base_flange[:3, 3], before.T_base_flange[:3, 3], atol=REPEAT_M)


def test_the_flange_keeps_its_speed_limit(host: str, settings: ArmSettings, witness: Witness):
    slow = settings.model_copy(update={"speed_rad_s": 1.0, "flange_speed_m_s": 0.1})
    arm = UrArm(slow, host)
    arm.connect()
    try:
        start, begin = arm.state().q_rad, witness.count
        # Slow enough for a long part at constant speed: 0.1 m at the distance of the flange from the axis of the base.
        arm.move(turned(start, 0.3))
        arm.move(start)
    finally:
        arm.close()
    _, q, qd = witness.since(begin)
    speeds = [np.linalg.norm(ur_kinematics.jacobian(slow.model, a)[:3] @ b) for a, b in zip(q, qd, strict=True)]
    assert max(speeds) <= 0.1 * 1.02  # the controller reports measured joint speeds
    reach_m = np.linalg.norm(ur_kinematics.forward(slow.model, start)[:2, 3])
    if reach_m > 0.15:  # the flange of an upright arm hardly moves
        assert max(speeds) > 0.05, "the flange is much slower than the limit"


def test_a_stop_ends_a_move_and_none_follows_before_a_new_connection(arm: UrArm, witness: Witness):
    start, begin = arm.state().q_rad, witness.count
    with thread_of(lambda: arm.move(turned(start, TURN_RAD))) as result:
        witness.wait_until(moving=True)
        time.sleep(0.3)
        arm.stop()
    assert isinstance(result[0], StoppedError)
    witness.wait_until(moving=False)
    clock, q, qd = witness.since(begin)
    assert q[-1][0] - start[0] < TURN_RAD / 2, "the arm did not stop before its goal"
    speed = np.abs(qd[:, 0])
    braking = np.flatnonzero(speed > 0.9 * speed.max())[-1]
    still = braking + np.flatnonzero(speed[braking:] < 0.02 * speed.max())[0]
    assert clock[still] - clock[braking] < STILL_S
    with pytest.raises(StoppedError):
        arm.move(start)
    time.sleep(0.5)
    assert not witness.moving
    arm.connect()
    np.testing.assert_allclose(arm.move(start).q_rad, start, atol=AT_GOAL_RAD)


def test_angles_beyond_the_safety_limits_cause_no_move(arm: UrArm, witness: Witness):
    start, begin = arm.state().q_rad, witness.count
    with pytest.raises(MotionError, match="safety limits"):
        arm.move(turned(start, 4 * np.pi))
    time.sleep(0.3)
    assert np.abs(witness.since(begin)[1] - start).max() < AT_GOAL_RAD
    arm.move(turned(start, 0.05))
    arm.move(start)


PARENT = """
import sys
sys.path.insert(0, {root!r})
import numpy as np
from cell.arm.ur_arm import UrArm
from cell.config.arm_config import ArmSettings
arm = UrArm(ArmSettings.model_validate_json({settings!r}), {host!r})
arm.connect()
start = arm.state().q_rad
print("connected", flush=True)
arm.move(start + [{turn}, 0, 0, 0, 0, 0])
"""


def test_the_watchdog_stops_the_arm_of_a_killed_process(
    host: str, settings: ArmSettings, witness: Witness, tmp_path: Path
):
    script = tmp_path / "parent.py"
    root = str(Path(__file__).parents[3])
    script.write_text(
        PARENT.format(root=root, settings=settings.model_dump_json(), host=host, turn=TURN_RAD), encoding="utf-8"
    )
    start = witness.q_rad
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline().strip() == "connected"
        witness.wait_until(moving=True)
        parent.kill()
        killed_at = witness.q_rad[0]
    witness.wait_until(moving=False)
    # 0.4 s of silence and the braking, at 0.5 rad/s. A busy machine may detect the silence later.
    assert witness.q_rad[0] - killed_at < 0.35
    assert witness.q_rad[0] - start[0] < TURN_RAD - 0.2, "the arm did not stop before its goal"
    until(lambda: not witness.program, 5.0)
    arm = UrArm(settings, host)
    arm.connect()
    arm.move(start)
    arm.close()


def test_a_robot_with_a_foreign_program_is_refused_and_unchanged(host: str, settings: ArmSettings, witness: Witness):
    other = Child("other", Pendant, host)
    try:
        other.call("hold", timeout_s=20.0)
        until(lambda: witness.program, 5.0)
        with pytest.raises(RobotNotReadyError, match="another program"):
            UrArm(settings, host).connect()
        time.sleep(0.5)
        assert witness.program
    finally:
        other.call("let_go", timeout_s=20.0)
        other.close()
    until(lambda: not witness.program, 5.0)


def test_a_robot_without_power_is_reported_and_unchanged(host: str, settings: ArmSettings):
    dashboard_client.send_command(host, "power off", timeout=10.0)
    until(lambda: "POWER_OFF" in dashboard_client.send_command(host, "robotmode", timeout=10.0), 20.0)
    try:
        with pytest.raises(RobotNotReadyError, match="not switched on"):
            UrArm(settings, host).connect()
        assert "POWER_OFF" in dashboard_client.send_command(host, "robotmode", timeout=10.0)
    finally:
        switch_on(host)
    arm = UrArm(settings, host)
    arm.connect()
    arm.close()
