"""The reason of a lost connection: the link, or this computer."""

import pytest

from cell.arm.arm_state import MAX_AGE_S, lost_connection_error
from cell.arm.rtde_state import RtdeState

SIX = (0.0,) * 6


def reading(age_s: float, silent_s: float) -> RtdeState:
    return RtdeState(
        q_rad=SIX, qd_rad_s=SIX, base_tcp=SIX, controller_s=1.0, age_s=age_s, connected=True, robot_mode="running",
        safety_mode="normal", program="playing", operation=0, operating=True, speed_fraction=1.0, silent_s=silent_s,
    )  # fmt: skip


def test_recent_data_are_no_loss_of_the_connection():
    assert lost_connection_error(reading(MAX_AGE_S, 3.0)) is None


@pytest.mark.parametrize(
    ("silent_s", "reason"),
    [(0.1, "sent nothing new for 0.9 s: check the network cable"), (0.9, "this computer stood still for 0.9 s")],
)
def test_old_data_are_blamed_on_who_was_silent(silent_s: float, reason: str):
    assert reason in str(lost_connection_error(reading(0.9, silent_s)))
