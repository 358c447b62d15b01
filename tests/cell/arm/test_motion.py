"""Supervision of a move: stops, the watchdog and the speed slider."""

from typing import Any

import numpy as np
import pytest

from cell.arm.motion import distance_from_line
from cell.arm.ur_arm import UrArm
from cell.config.arm_config import SimulatedArm
from cell.errors import MotionError, StoppedError
from cell.kinematics.move_duration import move_durations
from cell.process.child import Child
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.pendant import Pendant
from tests.cell.arm.virtual_arm import FAST, HOME, far, fresh, kinds, motion_commands, moving, stops, thread_of, until
from tests.cell.process.child_drivers import SlowToAllow

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def test_the_distance_from_a_line_in_joint_space():
    q_from, q_to = np.zeros(6), np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    assert distance_from_line(q_from, q_from, q_to) == 0.0
    assert distance_from_line(np.array([0.5, 1.0, 0.0, 0.0, 0.0, 0.0]), q_from, q_to) == pytest.approx(0.0, abs=1e-12)
    assert distance_from_line(np.array([0.5, 1.0, 0.0, -0.2, 0.0, 0.1]), q_from, q_to) == pytest.approx(0.2)
    # Beyond an end, the distance is from the end. A move without length is a point.
    assert distance_from_line(np.array([1.0, 2.3, 0.0, 0.0, 0.0, 0.0]), q_from, q_to) == pytest.approx(0.3)
    assert distance_from_line(np.full(6, 0.1), q_from, q_from) == pytest.approx(0.1)


def test_no_move_is_sent_after_a_stop_request(controller: RunningController, monkeypatch: pytest.MonkeyPatch):
    """The stop still waits for another call of the child, and no command of the move was sent before the request."""
    monkeypatch.setattr("cell.arm.connection.STOP_TURN_S", 5.0)  # so that the stop waits and does not kill the process
    begin = fresh(controller)
    arm = UrArm(FAST, controller.host, SlowToAllow)
    try:
        arm.connect()
        with thread_of(lambda: arm.move(far())) as result:
            until(lambda: any(is_limits_query(event) for event in controller.admin.log(begin)), 5.0)
            arm.stop()
        assert isinstance(result[0], StoppedError)
        events = controller.admin.log(begin)
        assert stops(events)
        assert not motion_commands(events)
        assert not kinds(events, "motion_start")
    finally:
        arm.close()


def test_a_watchdog_that_expires_during_braking_is_no_fault(
    controller: RunningController, monkeypatch: pytest.MonkeyPatch
):
    """The watchdog gets no signal after a stop, so it ends the program of an arm that brakes slowly."""
    # so that the stop waits for a busy machine: over the dashboard, it would end the program before the watchdog does
    monkeypatch.setattr("cell.arm.connection.STOP_TURN_S", 5.0)
    monkeypatch.setattr("cell.arm.connection.STOP_ANSWER_S", 5.0)
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


def is_limits_query(event: dict[str, Any]) -> bool:
    return event["kind"] == "command" and "within" in event["details"]["name"]


def test_the_speed_slider_slows_a_move_and_at_zero_ends_it(
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
        # With its speed restored, the arm does not continue, because the program has ended.
        pendant.call("slide_speed", 1.0, timeout_s=20.0)
        until(lambda: controller.admin.state().program_state == "STOPPED", 2.0)
        assert controller.admin.state().q_rad[0] < 1.9
    finally:
        arm.close()
        pendant.close()


def test_a_move_takes_the_predicted_time(controller: RunningController):
    settings = SimulatedArm()
    begin = fresh(controller)
    arm = UrArm(settings, controller.host)
    targets = [HOME + [0.02, 0, 0, 0, 0, 0], HOME + [0.5, 0.2, -0.2, 0.1, 0.3, 1.0]]
    try:
        arm.connect()
        for target in targets:
            arm.move(target)
    finally:
        arm.close()
    events = controller.admin.log(begin)
    starts, ends = ([event["stamp_s"] for event in kinds(events, kind)] for kind in ("motion_start", "motion_done"))
    predicted = move_durations(settings, np.array([HOME, targets[0]]), np.array(targets))
    # The controller's clock is exact. The tolerance is for rounding only.
    assert np.subtract(ends, starts) == pytest.approx(predicted, abs=1e-6)
