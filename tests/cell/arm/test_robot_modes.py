"""Robot and safety modes that do not allow a move."""

from typing import get_args

import pytest

from cell.arm.robot_modes import mode_error
from cell.devices import RobotMode, SafetyMode
from cell.errors import CellError, EmergencyStopError, ProtectiveStopError, RobotNotReadyError


@pytest.mark.parametrize(
    ("robot_mode", "safety_mode", "error", "words"),
    [
        ("running", "protective_stop", ProtectiveStopError, "then acknowledge"),
        ("running", "safeguard_stop", RobotNotReadyError, "close the door"),
        # An emergency stop also switches the power off. The button is the reason.
        ("power_off", "robot_emergency_stop", EmergencyStopError, "release the button"),
        ("power_off", "normal", RobotNotReadyError, "switch it on"),
        ("idle", "normal", RobotNotReadyError, "release its brakes"),
        ("backdrive", "normal", RobotNotReadyError, "freedrive"),
        ("running", "violation", RobotNotReadyError, "must be restarted"),
    ],
)
def test_each_mode_has_a_reason_and_an_action(
    robot_mode: RobotMode, safety_mode: SafetyMode, error: type[CellError], words: str
):
    found = mode_error(robot_mode, safety_mode)
    assert type(found) is error
    assert words in str(found)


def test_only_a_running_robot_in_a_normal_or_reduced_mode_may_move():
    free = [
        (robot_mode, safety_mode)
        for robot_mode in get_args(RobotMode)
        for safety_mode in get_args(SafetyMode)
        if mode_error(robot_mode, safety_mode) is None
    ]
    assert free == [("running", "normal"), ("running", "reduced")]
