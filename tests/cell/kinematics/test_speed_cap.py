import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cell.config.arm_models import ArmModelName
from cell.kinematics.speed_cap import capped_speed, max_flange_travel
from cell.kinematics.ur_kinematics import joint_speeds, link_frames

models: st.SearchStrategy[ArmModelName] = st.sampled_from(("ur3e", "ur5e", "ur10e"))
angles = st.lists(st.floats(-6.0, 6.0), min_size=6, max_size=6).map(np.array)
SAMPLES = 2000


def sampled_travel(model: ArmModelName, start: NDArray[np.float64], end: NDArray[np.float64]) -> float:
    """Return the largest distance of neighbouring samples of the flange origin, scaled to a whole move, metres."""
    points = link_frames(model, start + np.linspace(0, 1, SAMPLES)[:, None] * (end - start))[:, 6, :3, 3]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).max()) * (SAMPLES - 1)


@given(models, angles, angles, st.floats(0.05, 1.0))
@settings(max_examples=60)
def test_the_speed_reaches_the_limit_of_the_flange_or_of_a_joint(
    model: ArmModelName, start: NDArray[np.float64], end: NDArray[np.float64], limit: float
) -> None:
    furthest = np.abs(end - start).max()
    if furthest < 1e-3:
        return
    speed = capped_speed(model, start, end, 100.0, limit)
    reached = sampled_travel(model, start, end) * speed / furthest
    assert reached <= limit * (1 + 1e-9)
    rates = speed * np.abs(end - start) / furthest
    assert (rates <= joint_speeds(model) * (1 + 1e-12)).all()
    # Either the flange or a joint is near its limit. 3 % is allowed for positions between the samples.
    assert reached > 0.97 * limit or (rates / joint_speeds(model)).max() > 0.999


def test_the_base_of_a_stretched_arm_moves_the_flange_on_a_circle() -> None:
    stretched = np.zeros(6)
    turned = np.array([1.0, 0, 0, 0, 0, 0])
    # The flange moves on a circle whose radius follows from the table.
    radius = np.hypot(0.8172, 0.2329)
    assert max_flange_travel("ur5e", stretched, turned) == pytest.approx(radius, rel=1e-3)
    assert capped_speed("ur5e", stretched, turned, 3.0, 0.25) == pytest.approx(0.25 / radius, rel=1e-3)
    # A speed far below the limit is unchanged.
    assert capped_speed("ur5e", stretched, turned, 0.1, 0.25) == 0.1


def test_turning_the_last_joint_does_not_move_the_flange() -> None:
    turned = np.array([0, 0, 0, 0, 0, 2.0])
    assert capped_speed("ur5e", np.zeros(6), turned, 1.0, 0.01) == 1.0
    # The limit of the joint applies.
    assert capped_speed("ur5e", np.zeros(6), turned, 10.0, 0.25) == pytest.approx(np.pi)


def test_a_move_without_length_keeps_its_speed() -> None:
    assert capped_speed("ur5e", np.ones(6), np.ones(6), 1.0, 0.25) == 1.0
