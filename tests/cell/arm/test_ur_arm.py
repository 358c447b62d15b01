"""Connecting, moving, stopping and closing the arm, with the real ur_rtde and the virtual controller."""

import os
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from cell.arm.arm_state import STEADY_RAD_S
from cell.arm.dashboard import Command, Dashboard
from cell.arm.ur_arm import UrArm
from cell.devices import Arm
from cell.errors import CellError, MotionError, RobotLostError, RobotNotReadyError, RobotUnreachableError, StoppedError
from cell.kinematics import ur_kinematics
from cell.process.child import Child
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.pendant import Pendant
from tests.cell.arm.virtual_arm import (
    FAST,
    HOME,
    dashboard_commands,
    far,
    fresh,
    kinds,
    motion_commands,
    moving,
    stops,
    thread_of,
    until,
)
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

WIRE_S = 0.05
"""Promised limit of the time until a stop is on the wire, seconds."""
STILL_S = 0.35
"""Promised limit of the time from the stop until the arm is at rest, seconds."""


@pytest.fixture
def arm(controller: RunningController) -> Iterator[UrArm]:
    """Yield a connected arm at HOME."""
    fresh(controller)
    arm = UrArm(FAST, controller.host)
    arm.connect()
    yield arm
    arm.close()


def test_a_move_returns_the_reached_state(controller: RunningController, arm: UrArm):
    as_an_arm: Arm = arm
    state = as_an_arm.move(far(0.4))
    np.testing.assert_allclose(state.q_rad, far(0.4), atol=2e-3)
    assert np.abs(state.qd_rad_s).max() < 3e-3
    assert not state.moving
    assert (state.robot_mode, state.safety_mode) == ("running", "normal")
    # Both poses are from the kinematics of the controller, as pose vectors of doubles.
    np.testing.assert_allclose(state.T_base_flange, controller.admin.state().T_base_flange, atol=1e-9)
    assert arm.latest is state
    arm.check_ready()


def test_connect_returns_the_arm_and_close_frees_the_robot(controller: RunningController):
    begin = fresh(controller)
    arm = UrArm(FAST, controller.host)
    info = arm.connect()
    assert (info.model, bool(info.serial), bool(info.software)) == ("UR5", True, True)
    arm.close()
    events = controller.admin.log(begin)
    assert len(kinds(events, "script_upload")) == 1
    assert not kinds(events, "motion_start")
    assert controller.admin.state().program_state == "STOPPED"
    until(lambda: controller.admin.state().connections["rtde"] == 0, 5.0)


def test_a_tool_set_at_the_pendant_does_not_shift_the_flange(controller: RunningController):
    fresh(controller)
    setter = Child("tool", Pendant, controller.host)
    setter.call("set_tool", (0.02, -0.03, 0.17, 0.3, -0.2, 0.5), timeout_s=20.0)
    setter.close()
    until(lambda: controller.admin.state().connections["rtde"] == 0, 5.0)
    arm = UrArm(FAST, controller.host)
    arm.connect()
    try:
        state = arm.move(far(0.3))
        np.testing.assert_allclose(state.T_base_flange, controller.admin.state().T_base_flange, atol=1e-9)
        with thread_of(lambda: arm.move(far(0.6))):
            moving(controller)
            # The tool is removed from poses during a move too. The tolerance is that of the calibration of the arm.
            latest = arm.latest
            assert latest is not None
            T_nominal = ur_kinematics.forward("ur5e", latest.q_rad)
            np.testing.assert_allclose(latest.T_base_flange, T_nominal, atol=0.02)
    finally:
        arm.close()


def test_a_move_to_the_present_position_succeeds(arm: UrArm):
    np.testing.assert_allclose(arm.move(HOME).q_rad, HOME, atol=2e-3)


def test_rejected_angles_cause_no_move_and_the_arm_stays_usable(controller: RunningController, arm: UrArm):
    begin = controller.admin.state().events
    with pytest.raises(MotionError, match="safety limits"):
        arm.move(HOME + [7.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for q in (HOME[:5], HOME * np.nan):
        with pytest.raises(MotionError, match="six joint angles"):
            arm.move(q)
    assert not motion_commands(controller.admin.log(begin))
    arm.move(far(0.1))


@pytest.mark.parametrize(
    ("fault", "error"),
    [("local_mode", RobotNotReadyError), ("foreign_program", RobotNotReadyError), ("power_off", RobotNotReadyError)],
)
def test_a_robot_that_must_not_be_driven_is_unchanged(
    controller: RunningController, fault: str, error: type[CellError]
):
    begin = fresh(controller)
    getattr(controller.admin, fault)()
    state = controller.admin.state()
    arm = UrArm(FAST, controller.host)
    with pytest.raises(error):
        arm.connect()
    with pytest.raises(RobotNotReadyError, match="connect first"):
        arm.move(far())
    arm.close()
    controller.admin.clear()
    events = controller.admin.log(begin)
    assert not kinds(events, "script_upload", "command", "program_killed")
    assert "stop" not in dashboard_commands(events)
    assert controller.admin.state().program == state.program


def test_an_unreachable_robot_is_reported_within_three_seconds():
    arm = UrArm(FAST, free_host())
    begin = time.monotonic()
    with pytest.raises(RobotUnreachableError, match=r"check arm\.host"):
        arm.connect()
    assert time.monotonic() - begin < 3.0
    arm.stop()
    arm.close()


def test_an_arm_of_another_size_is_refused(controller: RunningController, monkeypatch: pytest.MonkeyPatch):
    begin = fresh(controller)
    settings = FAST.model_copy(update={"model": "ur3e"})
    with pytest.raises(RobotNotReadyError, match=r"the robot is a UR5, not 'ur3e' as arm\.model says"):
        UrArm(settings, controller.host).connect()
    assert not kinds(controller.admin.log(begin), "script_upload")
    # The model name has no size here, so the pose of the flange reveals the model. The arm has not moved then.
    monkeypatch.setattr("cell.arm.preflight.Dashboard.ask", _without_size(Dashboard.ask))
    with pytest.raises(RobotNotReadyError, match=r"mm from the position that a ur3e would have: correct arm\.model"):
        UrArm(settings, controller.host).connect()
    until(lambda: controller.admin.state().program_state == "STOPPED", 5.0)
    assert not motion_commands(controller.admin.log(begin))


def _without_size(ask: Callable[[Dashboard, Command], str]) -> Callable[[Dashboard, Command], str]:
    return lambda dashboard, command: "UR3" if command == "get robot model" else ask(dashboard, command)


@pytest.mark.parametrize(
    "count",
    [6, pytest.param(200, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])],
)
def test_stops_at_random_moments(controller: RunningController, arm: UrArm, count: int):
    """Each stop is on the wire in time, the arm comes to rest in time, and no motion command follows."""
    rng = random.Random(7)
    waits, stills = [], []
    for _ in range(count):
        begin = controller.admin.state().events

        def wander() -> None:
            while True:
                for turn in (0.5, 0.0):
                    arm.move(far(turn))

        with thread_of(wander) as result:
            time.sleep(rng.uniform(0.0, 1.0))
            called_s = time.monotonic()
            arm.stop()
        assert isinstance(result[0], StoppedError)
        for refused in (lambda: arm.move(far()), arm.check_ready):
            with pytest.raises(StoppedError):
                refused()
        # A stopped move ends when the arm is at rest. The controller counts as moving until the speed is exactly zero.
        assert np.abs(controller.admin.state().qd_rad_s).max() <= STEADY_RAD_S
        until(lambda: not controller.admin.state().moving, 5.0)
        events = controller.admin.log(begin)
        sent_s = next(stamp_s for stamp_s in stops(events) if stamp_s >= called_s)
        waits.append(sent_s - called_s)
        assert not [event for event in motion_commands(events) if event["stamp_s"] > sent_s]
        ends = [event["stamp_s"] for event in kinds(events, "still", "motion_done") if event["stamp_s"] > sent_s]
        stills.append(max(ends, default=sent_s) - sent_s)
        arm.connect()
    # One in a hundred (at least one) may be late on a busy machine.
    assert sorted(waits)[-1 - max(1, count // 100)] <= WIRE_S
    # By the clock of the controller.
    assert max(stills) <= STILL_S


def test_a_stopped_arm_at_rest_does_not_move_until_it_is_connected_again(controller: RunningController, arm: UrArm):
    arm.stop()
    arm.stop()
    with pytest.raises(StoppedError, match="connect, or start"):
        arm.move(far())
    # The controller is queried, because on a busy machine the stop may have closed the connection of the arm.
    assert not controller.admin.state().moving
    arm.connect()
    arm.move(far(0.1))


def test_a_stop_works_while_the_child_hangs(controller: RunningController, arm: UrArm):
    begin = controller.admin.state().events
    with thread_of(lambda: arm.move(far())) as result:
        moving(controller)
        assert arm._link.child is not None
        os.kill(arm._link.child.pid, signal.SIGSTOP)
        called_s = time.monotonic()
        arm.stop()
    assert isinstance(result[0], StoppedError)
    events = controller.admin.log(begin)
    assert "stop" in dashboard_commands(events)
    assert stops(events)[0] - called_s <= 2 * WIRE_S
    until(lambda: not controller.admin.state().moving, 2.0)
    assert controller.admin.state().q_rad[0] < 1.5
    arm.connect()
    arm.move(HOME)


def test_a_stop_during_connecting_cancels_it(controller: RunningController):
    begin = fresh(controller)
    arm = UrArm(FAST, controller.host)
    try:
        with thread_of(arm.connect) as result:
            until(lambda: arm._link.child is not None, 5.0)
            arm.stop()
        assert isinstance(result[0], StoppedError)
        with pytest.raises(CellError):
            arm.move(far())
        until(lambda: controller.admin.state().program_state == "STOPPED", 2.0)
        assert not motion_commands(controller.admin.log(begin))
    finally:
        arm.close()


def test_a_stop_at_the_start_of_connecting_cancels_it(controller: RunningController, arm: UrArm):
    """The former connection is still being closed, which takes long because its child hangs."""
    begin = controller.admin.state().events
    assert arm._link.child is not None
    os.kill(arm._link.child.pid, signal.SIGSTOP)
    with thread_of(arm.connect) as result:
        until(lambda: arm._link.child is None, 5.0)
        arm.stop()
    assert isinstance(result[0], StoppedError)
    with pytest.raises(StoppedError):
        arm.move(far())
    assert not motion_commands(controller.admin.log(begin))


def test_a_foreign_program_is_reported_and_not_ended(controller: RunningController, arm: UrArm):
    controller.admin.foreign_program()
    begin = controller.admin.state().events
    for attempt in (arm.state, lambda: arm.move(far()), arm.connect):
        with pytest.raises(RobotNotReadyError, match=r"another program \(welding.urp\)"):
            attempt()
    arm.close()
    events = controller.admin.log(begin)
    assert "stop" not in dashboard_commands(events)
    assert not kinds(events, "script_upload", "program_stopped")
    assert not motion_commands(events)
    assert controller.admin.state().program == "welding.urp"


def test_neither_a_move_nor_close_affects_a_foreign_program(controller: RunningController, arm: UrArm):
    controller.admin.foreign_program()
    begin = controller.admin.state().events
    with pytest.raises(RobotNotReadyError, match=r"another program \(welding.urp\)"):
        arm.move(far())
    assert not motion_commands(controller.admin.log(begin))
    controller.admin.reset(HOME)
    arm.connect()
    controller.admin.foreign_program()
    arm.close()  # the arm has not detected the program
    assert controller.admin.state().program == "welding.urp"


def test_close_stops_a_move(controller: RunningController, arm: UrArm):
    with thread_of(lambda: arm.move(far())) as result:
        moving(controller)
        arm.close()
    assert isinstance(result[0], CellError)
    until(lambda: not controller.admin.state().moving, 2.0)
    assert controller.admin.state().q_rad[0] < 1.5
    assert controller.admin.state().program_state == "STOPPED"


@pytest.mark.parametrize("silent", [False, True], ids=["answering", "silent"])
def test_a_program_that_was_ended_is_not_restarted_automatically(
    controller: RunningController, arm: UrArm, *, silent: bool
):
    """The child may be silent, as when it waits for an answer of the other program."""
    begin = controller.admin.state().events
    if silent:
        assert arm._link.child is not None
        os.kill(arm._link.child.pid, signal.SIGSTOP)
    controller.admin.foreign_program()
    controller.admin.reset(HOME)  # the other program ends, so that the robot is free and our program has ended
    until(lambda: controller.admin.state().program_state == "STOPPED", 5.0)
    with pytest.raises(RobotLostError, match="Connect again"):
        arm.move(far())
    events = controller.admin.log(begin)
    assert not kinds(events, "script_upload")
    assert not motion_commands(events)
    arm.connect()
    arm.move(far(0.1))


def test_repeated_connecting_leaks_nothing(controller: RunningController):
    fresh(controller)

    def open_files() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    arm = UrArm(FAST, controller.host)
    controller.admin.state()
    files, threads = open_files(), threading.active_count()
    for _ in range(4):
        arm.connect()
        arm.connect()
        arm.close()
        assert open_files() == files
        assert threading.active_count() == threads
    until(lambda: sum(controller.admin.state().connections.values()) <= 1, 5.0)
