"""How a watched move tells that the arm is not doing what it was sent to do."""

from typing import Any

import numpy as np
import pytest

from cell.arm.motion import distance_from_line
from cell.arm.ur_arm import UrArm
from cell.errors import MotionError, StoppedError
from cell.process.child import Child
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.pendant import Pendant
from tests.cell.arm.virtual_arm import FAST, far, fresh, kinds, motion_commands, moving, stops, thread_of, until
from tests.cell.process.child_drivers import SlowToAllow

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes


def test_the_distance_from_the_joint_line():
    q_from, q_to = np.zeros(6), np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    assert distance_from_line(q_from, q_from, q_to) == 0.0
    assert distance_from_line(np.array([0.5, 1.0, 0.0, 0.0, 0.0, 0.0]), q_from, q_to) == pytest.approx(0.0, abs=1e-12)
    assert distance_from_line(np.array([0.5, 1.0, 0.0, -0.2, 0.0, 0.1]), q_from, q_to) == pytest.approx(0.2)
    # Beyond an end counts from the end; a move of no length is a point.
    assert distance_from_line(np.array([1.0, 2.3, 0.0, 0.0, 0.0, 0.0]), q_from, q_to) == pytest.approx(0.3)
    assert distance_from_line(np.full(6, 0.1), q_from, q_from) == pytest.approx(0.1)


def test_a_move_does_not_leave_once_a_stop_was_asked_for(
    controller: RunningController, monkeypatch: pytest.MonkeyPatch
):
    """Also when the stop still waits for its turn; nothing of the move was sent when it was asked for."""
    monkeypatch.setattr("cell.arm.connection.STOP_TURN_S", 5.0)  # else it would not wait, and end the process
    begin = fresh(controller)
    arm = UrArm(FAST, controller.host, SlowToAllow)
    try:
        arm.connect()
        with thread_of(lambda: arm.move(far())) as result:
            until(lambda: any(asks_for_limits(event) for event in controller.admin.log(begin)), 5.0)
            arm.stop()
        assert isinstance(result[0], StoppedError)
        events = controller.admin.log(begin)
        assert stops(events)
        assert not motion_commands(events)
        assert not kinds(events, "motion_start")
    finally:
        arm.close()


def test_a_stop_that_outlasts_the_watchdog_is_no_fault(controller: RunningController):
    """Nobody keeps the watchdog quiet after a stop: an arm that brakes slowly is ended by it, as it was asked for."""
    begin = fresh(controller)
    arm = UrArm(FAST.model_copy(update={"stop_deceleration_m_s2": 1.0}), controller.host)
    try:
        arm.connect()
        with thread_of(lambda: arm.move(far())) as result:
            moving(controller, share=0.3)
            arm.stop()
        assert kinds(controller.admin.log(begin), "watchdog_expired")
        assert isinstance(result[0], StoppedError)
    finally:
        arm.close()


def asks_for_limits(event: dict[str, Any]) -> bool:
    return event["kind"] == "command" and "within" in event["details"]["name"]


def test_an_arm_whose_speed_is_turned_down_moves_slowly_and_one_that_is_held_is_given_up(
    controller: RunningController, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("cell.arm.motion.STALL_S", 0.5)
    fresh(controller)
    pendant = Child("pendant", Pendant, controller.host)
    arm = UrArm(FAST, controller.host)
    try:
        pendant.call("slide_speed", 0.3, timeout_s=20.0)
        arm.connect()
        arm.move(far(0.3))
        with thread_of(lambda: arm.move(far())) as result:
            moving(controller)
            pendant.call("slide_speed", 0.0, timeout_s=20.0)
        assert isinstance(result[0], MotionError)
        assert "speed slider is at 0%" in str(result[0])
        # Given back its speed, it does not go on: the program has ended.
        pendant.call("slide_speed", 1.0, timeout_s=20.0)
        until(lambda: controller.admin.state().program_state == "STOPPED", 2.0)
        assert controller.admin.state().q_rad[0] < 1.9
    finally:
        arm.close()
        pendant.close()
