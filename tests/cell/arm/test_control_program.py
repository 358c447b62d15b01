"""Ending the control program over the dashboard."""

import pytest

from cell.arm.control_program import ControlProgram
from cell.arm.dashboard import Command, Dashboard, stop_program
from cell.arm.fault_recovery import acknowledge_protective_stop
from cell.errors import RobotNotReadyError
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.virtual_arm import dashboard_commands, fresh, until

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def paused_program(controller: RunningController) -> ControlProgram:
    """Return a program in place of ours. It is paused, because its watchdog would end a playing program."""
    fresh(controller)
    program = ControlProgram(controller.host, watchdog_hz=2.5)
    controller.admin.foreign_program("rtde_control")
    program.mark_started()
    controller.admin.protective_stop()
    until(lambda: controller.admin.state().program_state == "PAUSED", 5.0)
    return program


def test_a_refused_end_of_the_program_is_repeated(controller: RunningController):
    program = paused_program(controller)
    controller.admin.local_mode()
    program.end(5.0, including_foreign=True)
    program.wait()
    assert program.there
    assert controller.admin.state().program_state == "PAUSED"
    controller.admin.clear()
    program.end(5.0, including_foreign=False)
    program.wait()
    assert not program.there
    assert controller.admin.state().program_state == "STOPPED"


def test_an_ended_program_is_not_searched_again(controller: RunningController):
    program = paused_program(controller)
    assert stop_program(controller.host, 5.0) == "Stopped"
    begin = controller.admin.state().events
    for _ in range(2):
        program.end(5.0, including_foreign=True)
        program.wait()
    assert not program.there
    assert dashboard_commands(controller.admin.log(begin)) == ["stop"]


def test_a_protective_stop_is_not_unlocked_while_the_program_exists(
    controller: RunningController, monkeypatch: pytest.MonkeyPatch
):
    """The robot is in local mode at the moment in which the program should be ended."""
    paused_program(controller)
    begin = controller.admin.state().events
    ask = Dashboard.ask

    def local_for_the_stop(dashboard: Dashboard, command: Command) -> str:
        if command == "stop":
            controller.admin.local_mode()
        answer = ask(dashboard, command)
        controller.admin.clear()
        return answer

    monkeypatch.setattr(Dashboard, "ask", local_for_the_stop)
    with pytest.raises(RobotNotReadyError, match=r"still on it .*stop it at the pendant"):
        acknowledge_protective_stop(controller.host, None, program_ours=True)
    assert controller.admin.state().program_state == "PAUSED"
    assert "unlock protective stop" not in dashboard_commands(controller.admin.log(begin))


def test_a_program_that_cannot_be_ended_is_not_acknowledged(controller: RunningController):
    fresh(controller)
    controller.admin.foreign_program("rtde_control")
    controller.admin.local_mode()
    with pytest.raises(RobotNotReadyError, match=r"still on it .*stop it at the pendant"):
        acknowledge_protective_stop(controller.host, None, program_ours=True)
    assert controller.admin.state().program_state == "PLAYING"
    controller.admin.reset()  # a person ends the program at the pendant and stays in local mode
    controller.admin.local_mode()
    acknowledge_protective_stop(controller.host, None, program_ours=True)
