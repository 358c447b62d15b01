"""The JSON document of the cell."""

import time
from dataclasses import replace

import numpy as np
import pytest

from cell.config.cell_config import CellSettings
from cell.control.status import CellStatus, State
from cell.devices import ArmState
from service.api.schemas.cell import MAX_STATE_AGE_S, cell_resource


def status(state: State, age_s: float) -> CellStatus:
    """Return the status of a cell whose arm state has this age."""
    arm = ArmState(
        q_rad=np.zeros(6),
        qd_rad_s=np.zeros(6),
        T_base_flange=np.eye(4),
        robot_mode="running",
        safety_mode="normal",
        moving=False,
        controller_s=0.0,
        age_s=0.0,
        read_s=time.monotonic() - age_s,
    )
    return CellStatus(state=state, slug=None, reason=None, arm_state=arm)


@pytest.mark.parametrize("state", ["ready", "busy", "fault"])
def test_modes_of_an_old_state_are_null(state: State) -> None:
    fresh = cell_resource(status(state, 0.0), CellSettings(), None, []).robot
    assert (fresh.robot_mode, fresh.safety_mode) == ("running", "normal")
    assert fresh.moving is (None if state == "fault" else False)
    old = cell_resource(status(state, MAX_STATE_AGE_S + 1.0), CellSettings(), None, []).robot
    assert (old.robot_mode, old.safety_mode, old.moving) == (None, None, None)
    assert old.q_rad == [0.0] * 6  # the last known joints, whose age is `age_s`
    assert old.age_s == pytest.approx(MAX_STATE_AGE_S + 1.0, abs=0.5)  # the duration of the test


def test_modes_are_null_as_soon_as_the_robot_is_lost() -> None:
    lost = replace(status("fault", 0.0), slug="robot-lost", reason="the watchdog heard nothing for 0.4 s")
    robot = cell_resource(lost, CellSettings(), None, []).robot
    assert (robot.robot_mode, robot.safety_mode, robot.moving) == (None, None, None)
