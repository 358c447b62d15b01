import numpy as np
import pytest

from cell.config.arm_config import ArmModelName, SimulatedArm
from cell.kinematics.move_duration import move_durations, path_duration
from cell.kinematics.speed_cap import capped_speed
from cell.simulation.ur_controller.robot.trajectories import JointMove

HOME = np.deg2rad((180.0, -100.0, 90.0, -80.0, -90.0, 0.0))


@pytest.mark.parametrize("model", ["ur3e", "ur5e", "ur10e"])
def test_the_duration_is_that_of_the_controllers_motion(model: ArmModelName) -> None:
    rng = np.random.default_rng(0)
    arm = SimulatedArm(model=model)
    start = rng.uniform(-3.0, 3.0, (60, 6))
    # short moves, which have no constant speed, and long ones
    end = start + rng.uniform(-1.0, 1.0, (60, 6)) * np.repeat((0.002, 0.05, 1.0), 20)[:, None]
    motions = [
        JointMove(a, b, capped_speed(model, a, b, arm.speed_rad_s, arm.flange_speed_m_s), arm.acceleration_rad_s2)
        for a, b in zip(start, end, strict=True)
    ]
    assert move_durations(arm, start, end) == pytest.approx([motion.duration_s for motion in motions], rel=1e-12)


def test_a_move_without_length_takes_no_time() -> None:
    assert move_durations(SimulatedArm(), HOME, HOME) == [0.0]
    assert move_durations(SimulatedArm(), HOME, np.zeros((0, 6))).shape == (0,)


def test_a_single_posture_is_the_end_of_all_moves() -> None:
    ends = HOME + np.array([[0.3, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.0]])
    arm = SimulatedArm()
    assert move_durations(arm, ends, HOME) == pytest.approx(move_durations(arm, HOME, ends), rel=1e-12)
    # The last joint does not move the flange: 1 rad at 1 rad/s, with 1 / 1.4 s to accelerate.
    assert move_durations(arm, HOME, ends)[1] == pytest.approx(1.0 + 1 / 1.4)


def test_the_arm_stops_at_each_waypoint() -> None:
    path = (HOME + 0.05, HOME + 0.1)
    arm = SimulatedArm()
    each = float(move_durations(arm, HOME, path[0])[0] + move_durations(arm, path[0], path[1])[0])
    assert path_duration(arm, HOME, path) == pytest.approx(each)
    assert path_duration(arm, HOME, path) > path_duration(arm, HOME, path[1:])
