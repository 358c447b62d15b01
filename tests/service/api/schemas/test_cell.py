"""The JSON document of the cell."""

from dataclasses import replace

import pytest

from cell.config.cell_config import CellSettings
from cell.control.status import State
from service.api.schemas.cell import MAX_STATE_AGE_S, cell_resource
from tests.service.cell_status import status_with_arm


@pytest.mark.parametrize("state", ["ready", "busy", "fault"])
def test_modes_of_an_old_state_are_null(state: State) -> None:
    fresh = cell_resource(status_with_arm(state), CellSettings(), None, []).robot
    assert (fresh.robot_mode, fresh.safety_mode) == ("running", "normal")
    assert fresh.moving is (None if state == "fault" else False)
    old = cell_resource(status_with_arm(state, age_s=MAX_STATE_AGE_S + 1.0), CellSettings(), None, []).robot
    assert (old.robot_mode, old.safety_mode, old.moving) == (None, None, None)
    assert old.q_rad == [0.0] * 6  # the last known joints, whose age is `age_s`
    assert old.age_s == pytest.approx(MAX_STATE_AGE_S + 1.0, abs=0.5)  # the duration of the test


def test_modes_are_null_as_soon_as_the_robot_is_lost() -> None:
    lost = replace(status_with_arm("fault"), slug="robot-lost", reason="the watchdog heard nothing for 0.4 s")
    robot = cell_resource(lost, CellSettings(), None, []).robot
    assert (robot.robot_mode, robot.safety_mode, robot.moving) == (None, None, None)
