"""What is asked of a controller before anything is started."""

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

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

QUESTIONS = {
    "robotmode", "safetystatus", "is in remote control", "programState", "get robot model", "get serial number",
    "PolyscopeVersion",
}  # fmt: skip


def test_it_only_asks_and_tells_who_answered(controller: RunningController):
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
def test_what_keeps_it_from_being_driven(controller: RunningController, fault: str, error: type[CellError], words: str):
    begin = fresh(controller)
    getattr(controller.admin, fault)()
    mark_started = time.monotonic()
    with pytest.raises(error, match=words):
        probe(controller.host, "ur5e")
    assert time.monotonic() - mark_started < 3.0  # what is promised to who waits for it
    controller.admin.clear()
    assert not kinds(controller.admin.log(begin), "script_upload", "command")


def test_another_model_is_refused_with_the_key_to_correct(controller: RunningController):
    fresh(controller)
    with pytest.raises(RobotNotReadyError, match=r"the robot is a UR5, not 'ur10e' as arm\.model says"):
        probe(controller.host, "ur10e")


def test_a_program_that_is_just_ending_is_waited_for(controller: RunningController):
    fresh(controller)
    controller.admin.foreign_program()
    ending = threading.Timer(0.3, controller.admin.reset)
    ending.start()
    assert probe(controller.host, "ur5e", ending_s=2.0).model == "UR5"
    ending.join()


def test_what_is_no_ur_controller_is_told_as_such():
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


def test_names_are_looked_up():
    try:
        socket.gethostbyname("localhost")
    except OSError:
        pytest.skip("this machine knows no name, not even its own: /etc/hosts is missing")
    assert resolve_host("localhost") == "127.0.0.1"


def test_addresses_are_taken_and_bad_names_told():
    assert resolve_host("127.0.0.9") == "127.0.0.9"
    # A label longer than DNS has: refused without asking anybody.
    with pytest.raises(RobotUnreachableError, match=r"is not known .*check arm\.host"):
        resolve_host("x" * 70 + ".invalid")


def test_versions_are_read_out_of_what_the_robot_says():
    assert software_version("URSoftware 5.12.4.1101661 (Jan 01 2023)") == "5.12.4"
    assert software_version("something else") == "something else"
