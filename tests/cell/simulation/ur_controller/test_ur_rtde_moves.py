"""The unmodified ur_rtde moves and stops the virtual arm. Times are those of the controller log."""

import os
import signal

import numpy as np
import pytest

from cell.simulation.ur_controller.controller import LATE_S
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.simulation.ur_controller import wheel
from tests.cell.simulation.ur_controller.cell_log import FAST, HOME_Q_RAD, LogSince, wait_for
from tests.cell.simulation.ur_controller.wheel import CONNECT

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

AWAY_Q_RAD = (HOME_Q_RAD + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])).tolist()
FAR_Q_RAD = (HOME_Q_RAD + np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])).tolist()
"""Goal far enough away for a stop at full speed."""
MOVE_S = 1 / 1.05 + 1.05 / 1.4


def test_an_asynchronous_move_has_its_duration_and_reports_its_progress(controller: RunningController):
    log = LogSince(controller.admin)
    seen = wheel.run(
        controller.host,
        CONNECT
        + """
before = control.getAsyncOperationProgressEx()
assert control.moveJ(arguments["q"], 1.05, 1.4, True)
stamps, angles, speeds, running, numbers = [], [], [], [], []
# State and answers come over links of their own: until both tell that it stands.
while not running or running[-1] or speeds[-1] or len(stamps) < 20:
    status = control.getAsyncOperationProgressEx()
    running.append(status.isAsyncOperationRunning()); numbers.append(status.operationId())
    stamps.append(receive.getTimestamp())
    speeds.append(receive.getActualQd()[0]); angles.append(receive.getActualQ()[0])
    time.sleep(0.01)
answer(before=[before.isAsyncOperationRunning(), before.operationId()], stamps=stamps, angles=angles, speeds=speeds,
       running=running, numbers=numbers)
""",
        q=AWAY_Q_RAD,
    )
    (start,), (done,) = log.events("motion_start"), log.events("motion_done")
    assert done["stamp_s"] - start["stamp_s"] == pytest.approx(MOVE_S, abs=1e-9)
    (command,) = [event for event in log.events("command") if event["details"]["number"] == 1]
    assert command["details"]["target"] == AWAY_Q_RAD
    assert command["details"]["asynchronous"]
    assert (command["details"]["speed"], command["details"]["acceleration"]) == (1.05, 1.4)
    assert start["stamp_s"] >= command["stamp_s"]
    np.testing.assert_array_equal(done["details"]["q_rad"], AWAY_Q_RAD)
    assert seen["before"] == [False, 0]
    assert set(seen["numbers"]) == {1}
    assert seen["angles"][-1] == pytest.approx(AWAY_Q_RAD[0])
    assert seen["speeds"][-1] == 0.0
    assert 0.5 < max(seen["speeds"]) <= 1.05 + 1e-9
    # The stream shows the trajectory of the log. The speed is the slope, up to its change during one or two packages.
    angles, stamps, speeds = (np.array(seen[name]) for name in ("angles", "stamps", "speeds"))
    moved = np.diff(stamps) > 0
    slope = np.diff(angles)[moved] / np.diff(stamps)[moved]
    middle = 0.5 * (speeds[1:] + speeds[:-1])[moved]
    assert np.median(np.abs(slope - middle)) < 0.02


def test_a_stop_during_a_move_brakes_with_its_deceleration(controller: RunningController):
    log = LogSince(controller.admin)
    seen = wheel.run(
        controller.host,
        CONNECT
        + """
control.moveJ(arguments["q"], 1.05, 1.4, True)
while receive.getActualQd()[0] < 1.04: time.sleep(0.002)
control.stopJ(4.0)
answer(speed=receive.getActualQd()[0], running=control.getAsyncOperationProgressEx().isAsyncOperationRunning(),
       program=control.isProgramRunning())
""",
        q=FAR_Q_RAD,
    )
    assert log.kinds("motion_start", "braking", "still", "motion_done") == ["motion_start", "braking", "still"]
    (braking,), (still,) = log.events("braking"), log.events("still")
    assert braking["details"]["reason"] == "stopj"
    assert still["stamp_s"] - braking["stamp_s"] == pytest.approx(1.05 / 4.0, rel=0.02)
    turned = still["details"]["q_rad"][0] - braking["details"]["q_rad"][0]
    assert turned == pytest.approx(1.05**2 / (2 * 4.0), rel=0.04)
    # The command may be read one RTDE package before the arm is at rest.
    assert seen["speed"] == pytest.approx(0.0, abs=0.05)
    assert not seen["running"]
    assert seen["program"]


def test_a_stop_of_a_synchronous_move_arrives_after_its_end(controller: RunningController):
    log = LogSince(controller.admin)
    wheel.run(
        controller.host,
        CONNECT
        + """
import threading
mover = threading.Thread(target=control.moveJ, args=(arguments["q"], 1.05, 1.4, False))
mover.start()
while mover.is_alive() and receive.getActualQd()[0] < 0.5: time.sleep(0.002)
control.stopJ(4.0)
answer()
""",
        q=AWAY_Q_RAD,
    )
    log.wait("motion_done")
    assert log.events("still") == []


def test_without_a_watchdog_the_move_of_a_killed_client_continues(controller: RunningController):
    log = LogSince(controller.admin)
    code = CONNECT + 'control.moveJ(arguments["q"], 1.05, 1.4, True); say("moving")'
    with wheel.Talk(controller.host, code, q=AWAY_Q_RAD) as talk:
        talk.hear("moving")
        os.kill(talk.process.pid, signal.SIGKILL)
        np.testing.assert_array_equal(log.wait("motion_done")["details"]["q_rad"], AWAY_Q_RAD)


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_expires_if_its_client_is_killed_or_suspended(controller: RunningController, end: int):
    log = LogSince(controller.admin)
    code = (
        CONNECT
        + """
assert control.setWatchdog(5.0)
control.moveJ(arguments["q"], 0.5, 1.4, True)
for k in range(10**9):
    control.kickWatchdog(); time.sleep(0.02)
    if k == 15: print("moving", flush=True)
"""
    )
    with wheel.Talk(controller.host, code, q=AWAY_Q_RAD) as talk:
        talk.hear("moving")
        ended_s = log.wait("watchdog_armed")["stamp_s"]
        os.kill(talk.process.pid, end)
        expired = log.wait("watchdog_expired")
        still = log.wait("still")
    # The times of the log exclude pauses of the controller process on a busy machine of 20 ms or more.
    assert 0.2 <= expired["details"]["silence_s"] < 0.2 + LATE_S + 0.005
    assert expired["stamp_s"] > ended_s
    assert 0 < still["stamp_s"] - expired["stamp_s"] <= 0.5 / 15.0 + 1e-6
    assert log.events("motion_done") == []
    assert log.wait("program_stopped")["details"]["reason"] == "watchdog"
    wait_for(lambda: controller.admin.state().program_state == "STOPPED", "the program has ended")
    assert controller.admin.state().watchdog_kicks > 10


def test_lines_and_paths_reach_their_goals(fast_controller: RunningController):
    log = LogSince(fast_controller.admin)
    seen = wheel.run(
        fast_controller.host,
        CONNECT
        + """
pose = receive.getActualTCPPose(); pose[2] -= 0.1; pose[0] += 0.05
moved = control.moveL(pose, 0.25, 1.2)
while abs(receive.getActualTCPPose()[2] - pose[2]) > 1e-6: time.sleep(0.002)
there = receive.getActualTCPPose()
path = [[*arguments["q"], 1.0, 1.4, 0.0], [*arguments["home"], 1.0, 1.4, 0.0]]
answer(moved=moved, wanted=pose, there=there, path=control.moveJ(path), unreachable=control.moveL([3, 0, 0, 0, 0, 0]))
""",
        q=AWAY_Q_RAD,
        home=HOME_Q_RAD.tolist(),
    )
    assert seen["moved"]
    np.testing.assert_allclose(seen["there"][:3], seen["wanted"][:3], atol=1e-6)
    way_m = np.hypot(0.1, 0.05)
    assert log.events("motion_start")[0]["details"]["duration_s"] == pytest.approx(way_m / 0.25 + 0.25 / 1.2)
    assert seen["path"]
    arrivals = [event["details"]["q_rad"] for event in log.events("motion_done")]
    np.testing.assert_allclose(arrivals[1:], [AWAY_Q_RAD, HOME_Q_RAD], atol=1e-5)  # the script text has six digits
    assert not seen["unreachable"]
    assert "out of reach" in log.wait("safety")["details"]["cause"]


def test_an_unreachable_pose_kills_the_program(controller: RunningController):
    log = LogSince(controller.admin)
    wheel.run(controller.host, CONNECT + "control.moveJ_IK([3.0, 0, 0.5, 0, 0, 0], 1.0, 1.0, True); answer()")
    assert "out of reach" in log.wait("script_error")["details"]["error"]
    assert log.events("motion_start") == []
    assert controller.admin.state().program_state == "STOPPED"


def test_the_time_factor_speeds_up_the_arm_only(fast_controller: RunningController):
    log = LogSince(fast_controller.admin)
    wheel.run(
        fast_controller.host,
        CONNECT
        + """
control.moveJ(arguments["q"], 1.05, 1.4)
control.setWatchdog(10.0); time.sleep(0.5)
answer()
""",
        q=AWAY_Q_RAD,
    )
    (start,), (done,) = log.events("motion_start"), log.events("motion_done")
    assert done["stamp_s"] - start["stamp_s"] == pytest.approx(MOVE_S / FAST, abs=1e-9)
    assert 0.1 <= log.wait("watchdog_expired")["details"]["silence_s"] < 0.1 + LATE_S + 0.005
