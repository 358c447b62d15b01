"""The JSON document of the cell."""

from dataclasses import replace

import pytest

from cell.config.cell_config import CellSettings
from cell.control.status import State
from service.api.schemas.cell import MAX_STATE_AGE_S, cell_resource
from service.jobs.interventions import Interventions
from tests.service.cell_status import status_with_arm


@pytest.mark.parametrize("state", ["ready", "busy", "fault"])
def test_modes_of_an_old_state_are_null(state: State) -> None:
    fresh = cell_resource(status_with_arm(state), CellSettings(), None, [], Interventions()).robot
    assert (fresh.robot_mode, fresh.safety_mode) == ("running", "normal")
    assert fresh.moving is (None if state == "fault" else False)
    old = cell_resource(
        status_with_arm(state, age_s=MAX_STATE_AGE_S + 1.0), CellSettings(), None, [], Interventions()
    ).robot
    assert (old.robot_mode, old.safety_mode, old.moving) == (None, None, None)
    assert old.q_rad == [0.0] * 6  # the last known joints, whose age is `age_s`
    assert old.age_s == pytest.approx(MAX_STATE_AGE_S + 1.0, abs=0.5)  # the duration of the test


def test_modes_are_null_as_soon_as_the_robot_is_lost() -> None:
    lost = replace(status_with_arm("fault"), slug="robot-lost", reason="the watchdog heard nothing for 0.4 s")
    robot = cell_resource(lost, CellSettings(), None, [], Interventions()).robot
    assert (robot.robot_mode, robot.safety_mode, robot.moving) == (None, None, None)


def test_the_last_stop_and_the_last_acknowledgement_have_a_time_and_a_caller() -> None:
    interventions = Interventions()
    before = cell_resource(status_with_arm("ready"), CellSettings(), None, [], interventions)
    assert (before.last_stop, before.last_acknowledgement) == (None, None)
    interventions.record_stop("kim")
    interventions.record_acknowledgement("lee")
    interventions.record_stop(None)  # by a caller without a token
    after = cell_resource(status_with_arm("ready"), CellSettings(), None, [], interventions)
    assert after.last_stop is not None
    assert after.last_acknowledgement is not None
    assert (after.last_stop.by, after.last_acknowledgement.by) == (None, "lee")
    assert after.last_acknowledgement.at <= after.last_stop.at
