import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.simulation.ur_controller.robot.trajectories import Braking, JointMove, LineMove, Motion, Trapezoid

positive = st.floats(min_value=0.01, max_value=10.0)


def largest_jumps(motion: Motion, steps: int = 4000) -> tuple[float, float]:
    """Return the largest change of a joint and of a joint speed between neighbouring times, per second."""
    t = np.linspace(-0.01, motion.duration_s + 0.01, steps)
    samples = [motion.at(max(0.0, each)) for each in t]
    q, qd = np.array([each[0] for each in samples]), np.array([each[1] for each in samples])
    dt = t[1] - t[0]
    return float(np.abs(np.diff(q, axis=0)).max() / dt), float(np.abs(np.diff(qd, axis=0)).max() / dt)


def test_the_duration_of_one_radian_is_that_of_the_trapezoid():
    # Distance / speed + speed / acceleration, as a real arm within one or two cycles.
    assert Trapezoid(1.0, 1.05, 1.4).duration_s == pytest.approx(1 / 1.05 + 1.05 / 1.4, rel=1e-12)


def test_a_short_move_does_not_reach_its_speed():
    short = Trapezoid(0.1, 1.05, 1.4)
    assert short.duration_s == pytest.approx(2 * np.sqrt(0.1 / 1.4))
    assert max(short.at(t)[1] for t in np.linspace(0, short.duration_s, 501)) <= np.sqrt(0.1 * 1.4) + 1e-12


@given(length=positive, speed=positive, acceleration=positive, share=st.floats(0.0, 1.0))
def test_any_move_keeps_its_limits_and_integrates_its_speed(
    length: float, speed: float, acceleration: float, share: float
):
    way = Trapezoid(length, speed, acceleration)
    t, h = share * way.duration_s, 1e-6 * way.duration_s
    done, rate = way.at(t)
    assert 0.0 <= done <= length * (1 + 1e-12)
    assert 0.0 <= rate <= speed * (1 + 1e-12)
    later = way.at(t + h)
    # Second-order terms of the step and the rounding of the difference.
    assert later[0] - done == pytest.approx(rate * h, abs=acceleration * h**2 + 1e-12 * length)
    assert abs(later[1] - rate) <= acceleration * h * (1 + 1e-6) + 1e-9 * speed
    assert way.at(way.duration_s) == (length, 0.0)


def test_the_joints_are_synchronous_and_the_leading_one_keeps_the_limits():
    q_from, q_to = np.zeros(6), np.array([1.0, -0.5, 0.25, 0.0, 0.1, -0.2])
    move = JointMove(q_from, q_to, 1.05, 1.4)
    for t in np.linspace(0.0, move.duration_s, 50):
        q, qd = move.at(t)
        np.testing.assert_allclose(q, q[0] * q_to, atol=1e-12)
        assert np.abs(qd).max() == pytest.approx(abs(qd[0]))
    speed, acceleration = largest_jumps(move)
    assert speed == pytest.approx(1.05, rel=1e-3)
    assert acceleration == pytest.approx(1.4, rel=1e-2)
    np.testing.assert_array_equal(move.at(move.duration_s)[0], q_to)


def test_a_move_to_the_present_position_takes_no_time():
    move = JointMove(np.ones(6), np.ones(6), 1.0, 1.0)
    assert move.duration_s == 0.0
    np.testing.assert_array_equal(move.at(0.0)[0], np.ones(6))
    np.testing.assert_array_equal(move.at(0.0)[1], np.zeros(6))


def test_the_braking_time_is_the_speed_divided_by_the_deceleration():
    qd = np.array([1.05, -0.5, 0.0, 0.0, 0.0, 0.0])
    braking = Braking(np.zeros(6), qd, 1.05 / 4.0)
    np.testing.assert_allclose(braking.at(99.0)[0], 0.5 * braking.duration_s * qd)
    np.testing.assert_array_equal(braking.at(99.0)[1], np.zeros(6))
    assert largest_jumps(braking)[0] <= 1.05 + 1e-6


def test_a_line_passes_its_steps_and_keeps_the_speed_along_it():
    steps = np.linspace(np.zeros(6), np.full(6, 0.3), 4)
    move = LineMove(steps, 0.06, 0.1, 0.5)
    np.testing.assert_array_equal(move.at(move.duration_s)[0], steps[-1])
    middle = move.at(0.5 * move.duration_s)
    np.testing.assert_allclose(middle[0], 0.15, atol=1e-9)
    np.testing.assert_allclose(middle[1], 0.1 / 0.06 * 0.3, rtol=1e-9)
