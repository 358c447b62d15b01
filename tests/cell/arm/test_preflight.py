"""Checks of a controller before a program is started."""

import socket
import threading
import time

import pytest

from cell.arm.preflight import RTDE_PORT, probe, resolve_host, software_version
from cell.devices import ArmInfo
from cell.errors import CellError, EmergencyStopError, ProtectiveStopError, RobotNotReadyError, RobotUnreachableError
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.virtual_arm import dashboard_commands, fresh, kinds
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

QUESTIONS = {
    "robotmode", "safetystatus", "is in remote control", "programState", "get robot model", "get serial number",
    "PolyscopeVersion",
}  # fmt: skip


def test_the_check_only_queries_and_returns_the_arm(controller: RunningController):
    begin = fresh(controller)
    info = probe(controller.host, "ur5e")
    assert info == ArmInfo(model="UR5", serial=info.serial, software="5.25.1")
    assert info.serial
    events = controller.admin.log(begin)
    assert set(dashboard_commands(events)) == QUESTIONS
    assert not kinds(events, "script_upload", "command", "rtde_start")


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("local_mode", RobotNotReadyError, "local mode: switch it to remote control"),
        ("power_off", RobotNotReadyError, "not switched on"),
        ("foreign_program", RobotNotReadyError, r"another program \(welding.urp\) .*playing"),
        ("protective_stop", ProtectiveStopError, "look at the cell"),
        ("emergency_stop", EmergencyStopError, "release the button"),
        ("half_open", RobotUnreachableError, "accepts connections .*but does not answer"),
        ("unreachable", RobotUnreachableError, r"no robot answers .*check arm\.host"),
    ],
)
def test_each_obstacle_is_reported_and_nothing_is_started(
    controller: RunningController, fault: str, error: type[CellError], words: str
):
    begin = fresh(controller)
    getattr(controller.admin, fault)()
    mark_started = time.monotonic()
    with pytest.raises(error, match=words):
        probe(controller.host, "ur5e")
    assert time.monotonic() - mark_started < 3.0  # the promised limit
    controller.admin.clear()
    assert not kinds(controller.admin.log(begin), "script_upload", "command")


def test_another_model_is_refused_with_the_key_to_correct(controller: RunningController):
    fresh(controller)
    with pytest.raises(RobotNotReadyError, match=r"the robot is a UR5, not 'ur10e' as arm\.model says"):
        probe(controller.host, "ur10e")


def test_the_check_waits_for_a_program_that_is_ending(controller: RunningController):
    fresh(controller)
    controller.admin.foreign_program()
    ending = threading.Timer(0.3, controller.admin.reset)
    ending.start()
    assert probe(controller.host, "ur5e", ending_s=2.0).model == "UR5"
    ending.join()


def test_another_server_is_reported_as_no_ur_controller():
    host = free_host()
    with socket.create_server((host, RTDE_PORT)) as listener:

        def greet() -> None:
            link, _ = listener.accept()
            with link:
                link.recv(100)
                link.sendall(b"SSH-2.0-OpenSSH_9.6\r\n")

        thread = threading.Thread(target=greet)
        thread.start()
        with pytest.raises(RobotUnreachableError, match="not a UR controller"):
            probe(host, "ur5e")
        thread.join(10.0)


def test_a_host_name_is_resolved():
    try:
        socket.gethostbyname("localhost")
    except OSError:
        pytest.skip("this machine knows no name, not even its own: /etc/hosts is missing")
    assert resolve_host("localhost") == "127.0.0.1"


def test_an_address_is_accepted_and_an_unknown_name_is_rejected():
    assert resolve_host("127.0.0.9") == "127.0.0.9"
    # The label is too long for DNS, so it is refused without a query.
    with pytest.raises(RobotUnreachableError, match=r"is not known .*check arm\.host"):
        resolve_host("x" * 70 + ".invalid")


def test_the_software_version_is_parsed():
    assert software_version("URSoftware 5.12.4.1101661 (Jan 01 2023)") == "5.12.4"
    assert software_version("something else") == "something else"
