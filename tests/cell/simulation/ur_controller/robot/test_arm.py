import numpy as np
import pytest

from cell.simulation.ur_controller.robot.arm import HANDOVER_RAD_S2, Arm
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.targets import joint_goal

FAR = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
DURATION_S = 1 / 1.05 + 1.05 / 1.4


def new_arm(time_factor: float = 1.0) -> tuple[Arm, EventLog]:
    log = EventLog()
    return Arm("ur5e", np.zeros(6), time_factor, log, now_s=100.0), log


def stamps(log: EventLog, kind: str) -> list[float]:
    return [event["stamp_s"] for event in log.since(0) if event["kind"] == kind]


@pytest.mark.parametrize("cycles", [1, 7, 1000])
def test_the_position_depends_on_the_time_and_not_on_the_number_of_queries(cycles: int):
    arm, log = new_arm()
    arm.go(joint_goal(FAR, 1.05, 1.4))
    for now_s in np.linspace(100.0, 100.9, cycles + 1)[1:]:
        arm.advance(now_s)
    # 0.75 s of acceleration, then full speed.
    assert arm.q[0] == pytest.approx(0.5 * 1.4 * 0.75**2 + 1.05 * 0.15)
    assert arm.qd[0] == pytest.approx(1.05)
    arm.advance(200.0)
    assert stamps(log, "motion_done") == [pytest.approx(100.0 + DURATION_S)]
    np.testing.assert_array_equal(arm.q, FAR)
    assert arm.still
    assert not arm.busy


def test_the_time_factor_speeds_up_moves_and_stops():
    arm, log = new_arm(time_factor=10.0)
    arm.go(joint_goal(FAR, 1.05, 1.4))
    arm.advance(100.09)
    assert arm.qd[0] == pytest.approx(10.5)
    arm.brake(4.0, "stopj")
    arm.advance(101.0)
    assert stamps(log, "still") == [pytest.approx(100.09 + 1.05 / 4.0 / 10.0)]
    assert arm.q[0] == pytest.approx(0.39375 + 0.1575 + 1.05**2 / (2 * 4.0))


def test_the_speed_slider_slows_a_move_and_zero_pauses_it():
    arm, _ = new_arm()
    arm.go(joint_goal(FAR, 1.05, 1.4))
    arm.speed_fraction = 0.5
    arm.advance(101.8)
    assert (arm.q[0], arm.qd[0]) == (pytest.approx(0.39375 + 0.1575), pytest.approx(0.525))
    arm.speed_fraction = 0.0
    arm.advance(150.0)
    assert (arm.q[0], arm.qd[0]) == (pytest.approx(0.39375 + 0.1575), 0.0)
    assert arm.moment_of(0.9) is None
    arm.speed_fraction = 1.0
    arm.advance(150.0 + DURATION_S)
    np.testing.assert_array_equal(arm.q, FAR)


def test_a_new_goal_during_a_move_is_reached_after_a_stop():
    arm, log = new_arm()
    arm.go(joint_goal(FAR, 1.05, 1.4))
    arm.advance(100.8)
    arm.go(joint_goal(np.zeros(6), 1.05, 1.4))
    arm.advance(100.8 + 1.05 / HANDOVER_RAD_S2 + 1e-9)
    farthest = arm.q[0]
    arm.advance(110.0)
    assert farthest == pytest.approx(0.39375 + 1.05 * 0.05 + 1.05**2 / (2 * HANDOVER_RAD_S2))
    np.testing.assert_array_equal(arm.q, np.zeros(6))
    kinds = [event["kind"] for event in log.since(0)]
    assert kinds == ["motion_start", "braking", "still", "motion_start", "motion_done"]


def test_a_second_stop_can_only_increase_the_deceleration():
    arm, log = new_arm()
    arm.go(joint_goal(FAR, 1.05, 1.4))
    arm.advance(100.8)
    arm.brake(4.0, "stopj")
    arm.advance(100.85)
    arm.brake(1.0, "gentler")
    arm.brake(40.0, "firmer")
    arm.advance(110.0)
    assert [event["details"]["reason"] for event in log.since(0) if event["kind"] == "braking"] == ["stopj", "firmer"]
    assert stamps(log, "still") == [pytest.approx(100.85 + (1.05 - 4.0 * 0.05) / 40.0)]


def test_a_paused_move_continues_to_its_goal():
    arm, _ = new_arm()
    goal = joint_goal(FAR, 1.05, 1.4)
    arm.go(goal)
    arm.advance(100.8)
    assert arm.pause(HANDOVER_RAD_S2, "pause") is goal
    arm.advance(110.0)
    assert 0.39 < arm.q[0] < 0.6
    arm.go(goal)
    arm.advance(120.0)
    np.testing.assert_array_equal(arm.q, FAR)


def test_the_time_of_a_share_is_when_that_share_is_done():
    arm, _ = new_arm(time_factor=2.0)
    arm.go(joint_goal(FAR, 1.05, 1.4))
    moment_s = arm.moment_of(0.5)
    assert moment_s == pytest.approx(100.0 + DURATION_S / 4)
    arm.advance(100.7)
    assert arm.moment_of(0.5) == pytest.approx(100.7)  # it has passed


def test_a_tool_stop_takes_the_speed_divided_by_the_deceleration():
    arm, log = new_arm()
    arm.go(joint_goal(FAR, 1.05, 1.4))
    arm.advance(100.8)
    speed_m_s = 1.05 * np.hypot(*arm.T_base_flange[:2, 3])  # joint 1 alone swings the whole arm
    arm.brake_tool(5.0, "stopl")
    arm.advance(110.0)
    assert stamps(log, "still") == [pytest.approx(100.8 + speed_m_s / 5.0, rel=1e-6)]
