"""The dashboard server with a third-party client."""

import contextlib
import re
import socket
import time

import pytest
from universal_robots_clients import dashboard_client

from cell.config.arm_models import simulated_serial
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.simulation.ur_controller.cell_log import LogSince, wait_for

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def ask(controller: RunningController, command: str) -> str:
    return dashboard_client.send_command(controller.host, command, timeout=20.0)


def test_the_state_and_the_versions_are_answered(controller: RunningController):
    assert ask(controller, "robotmode") == "Robotmode: RUNNING"
    assert ask(controller, "safetystatus") == ask(controller, "safetymode").replace("mode", "status")
    assert ask(controller, "safetymode") == "Safetymode: NORMAL"
    assert ask(controller, "is in remote control") == "true"
    assert ask(controller, "running") == "Program running: false"
    assert dashboard_client.get_program_state(controller.host) == "STOPPED <unnamed>"
    assert ask(controller, "get loaded program") == "No program loaded"
    assert ask(controller, "PolyscopeVersion").startswith("URSoftware 5.25.1")
    assert ask(controller, "get robot model") == "UR5"
    assert ask(controller, "get serial number") == simulated_serial("ur5e")
    assert ask(controller, "ROBOTMODE") == "Robotmode: RUNNING"
    assert ask(controller, "make coffee") == "could not understand: 'make coffee'"
    assert ask(controller, "load weave.urp") == "File not found: weave.urp"


def test_several_commands_on_one_connection_are_answered_in_order(controller: RunningController):
    with socket.create_connection((controller.host, 29999), timeout=10.0) as connection:
        connection.sendall(b"robotmode\nsafetymode\nquit\n")
        lines = connection.makefile().read().splitlines()
    assert lines == [
        "Connected: Universal Robots Dashboard Server", "Robotmode: RUNNING", "Safetymode: NORMAL", "Disconnected",
    ]  # fmt: skip


def test_program_commands_fail_without_a_program(controller: RunningController):
    assert dashboard_client.stop_program(controller.host) == "Failed to execute: stop"
    assert dashboard_client.pause_program(controller.host) == "Failed to execute: pause"
    assert dashboard_client.play_program(controller.host) == "Failed to execute: play"


def test_a_loaded_program_is_paused_resumed_stopped_and_started(controller: RunningController):
    controller.admin.foreign_program("weave.urp")
    assert ask(controller, "programState") == "PLAYING weave.urp"
    assert ask(controller, "running") == "Program running: true"
    assert ask(controller, "pause") == "Pausing program"
    assert ask(controller, "programState") == "PAUSED weave.urp"
    assert ask(controller, "play") == "Starting program"
    assert ask(controller, "stop") == "Stopped"
    assert ask(controller, "programState") == "STOPPED weave.urp"
    assert ask(controller, "isProgramSaved") == "true weave.urp"
    assert ask(controller, "get loaded program") == "Loaded program: weave.urp"
    assert ask(controller, "play") == "Starting program"
    assert ask(controller, "programState") == "PLAYING weave.urp"


def test_in_local_control_queries_are_answered_and_commands_refused(controller: RunningController):
    controller.admin.foreign_program()
    controller.admin.local_mode()
    assert ask(controller, "is in remote control") == "false"
    for command in ("play", "stop", "pause", "power off", "unlock protective stop", "load x.urp",
                    "load installation default.installation", "restart safety"):  # fmt: skip
        assert "switch robot to Remote Control mode" in ask(controller, command)
    assert ask(controller, "robotmode") == "Robotmode: RUNNING"
    assert controller.admin.state().program_state == "PLAYING"
    controller.admin.clear()
    assert ask(controller, "stop") == "Stopped"


def test_the_power_is_switched_off_and_on(controller: RunningController):
    log = LogSince(controller.admin)
    assert ask(controller, "power off") == "Powering off"
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"
    assert ask(controller, "power on") == "Powering on"
    wait_for(lambda: ask(controller, "robotmode") == "Robotmode: IDLE", "idle")
    assert ask(controller, "brake release") == "Brake releasing"
    wait_for(lambda: ask(controller, "robotmode") == "Robotmode: RUNNING", "running")
    assert [event["details"]["mode"] for event in log.events("robot_mode")] == [
        "POWER_OFF", "POWER_ON", "IDLE", "RUNNING",
    ]  # fmt: skip


@pytest.mark.parametrize("pending", [False, True])
def test_releasing_the_brakes_powers_on_first(controller: RunningController, pending: bool):
    ask(controller, "power off")
    log = LogSince(controller.admin)
    if pending:
        assert ask(controller, "power on") == "Powering on"
    assert ask(controller, "brake release") == "Brake releasing"
    wait_for(lambda: ask(controller, "robotmode") == "Robotmode: RUNNING", "running")
    assert [event["details"]["mode"] for event in log.events("robot_mode")] == ["POWER_ON", "IDLE", "RUNNING"]


def test_powering_off_cancels_a_pending_release_of_the_brakes(controller: RunningController):
    ask(controller, "power off")
    ask(controller, "brake release")
    ask(controller, "power off")
    ask(controller, "power on")
    wait_for(lambda: ask(controller, "robotmode") == "Robotmode: IDLE", "idle")
    time.sleep(0.4)  # longer than a release of the brakes takes
    assert ask(controller, "robotmode") == "Robotmode: IDLE"


@pytest.mark.parametrize("request_", ["quitx", "quit now", "playx", "loadx.urp", "popupx", "robotmodes", "stop it"])
def test_requests_match_whole_words(controller: RunningController, request_: str):
    controller.admin.foreign_program()
    with socket.create_connection((controller.host, 29999), timeout=10.0) as connection:
        connection.sendall(f"{request_}\nrobotmode\n".encode())
        stream = connection.makefile()
        lines = [stream.readline().strip() for _ in range(3)]
    assert lines[1:] == [f"could not understand: '{request_}'", "Robotmode: RUNNING"]
    assert controller.admin.state().program_state == "PLAYING"


def test_the_operational_mode_is_kept_until_it_is_cleared(controller: RunningController):
    assert ask(controller, "get operational mode") == "NONE"
    for mode in ("manual", "automatic", "MANUAL", "AUTOMATIC"):
        assert ask(controller, f"set operational mode {mode}") == f"Operational mode '{mode}' is set"
        assert ask(controller, "get operational mode") == mode.upper()
    assert ask(controller, "set operational mode fast") == "Failed setting operational mode: fast"
    assert ask(controller, "get operational mode") == "AUTOMATIC"
    cleared = "No longer controlling the operational mode. Current operational mode: 'NONE'."
    assert ask(controller, "clear operational mode") == cleared
    assert ask(controller, "get operational mode") == "NONE"
    ask(controller, "set operational mode manual")
    controller.admin.reset(None)
    assert ask(controller, "get operational mode") == "NONE"


# The patterns are those that UR's client library expects.
@pytest.mark.parametrize(
    ("request_", "pattern"),
    [
        ("load installation default.installation", "Loading installation: default.installation"),
        ("load installation /programs/default.installation", "Loading installation: /programs/default.installation"),
        ("load installation other.installation", "File not found: other.installation"),
        ("generate flight report controller", r"Flight Report generated with id: \S+"),
        ("generate flight report ", r"Flight Report generated with id: \S+"),
        ("generate flight report coffee", "Failed to execute: generate flight report coffee"),
        ("generate support file .", r"Completed successfully: ur_\d+_\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d\.zip"),
        ("generate support file", "Error: no directory was given"),
        ("addToLog Testing Log:", "Added log message"),
        ("addToLog", "No log message to add"),
        ("saveLog", "Log saved to disk"),
        ("popup Test", "showing popup"),
        ("close popup", "closing popup"),
        ("close safety popup", "closing safety popup"),
        ("getUserRole", "could not understand: 'getUserRole'"),
    ],
)
def test_requests_are_answered_in_the_wording_of_the_real_server(
    controller: RunningController, request_: str, pattern: str
):
    assert re.fullmatch(pattern, ask(controller, request_))


def test_each_flight_report_has_its_own_id(controller: RunningController):
    assert len({ask(controller, "generate flight report system") for _ in range(3)}) == 3


def test_restarting_the_safety_system_switches_the_arm_off(controller: RunningController):
    controller.admin.protective_stop()
    assert ask(controller, "restart safety") == "Restarting safety"
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"
    assert ask(controller, "safetystatus") == "Safetystatus: NORMAL"
    controller.admin.emergency_stop()
    ask(controller, "restart safety")
    assert ask(controller, "safetystatus") == "Safetystatus: ROBOT_EMERGENCY_STOP"


def test_after_a_shutdown_the_controller_refuses_connections_until_it_is_started_again(controller: RunningController):
    controller.admin.local_mode()
    assert "Remote Control" in ask(controller, "shutdown")
    controller.admin.clear()
    assert ask(controller, "shutdown") == "Shutting down"

    def is_refused() -> bool:
        try:
            socket.create_connection((controller.host, 29999), timeout=10.0).close()
        except ConnectionRefusedError:
            return True
        except ConnectionResetError:
            # the server closed while it was being connected to
            return False
        return False

    wait_for(is_refused, "the dashboard refuses connections")
    controller.admin.clear()
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"


def test_an_emergency_stop_switches_off_and_cannot_be_released_remotely(controller: RunningController):
    controller.admin.emergency_stop()
    assert ask(controller, "safetystatus") == "Safetystatus: ROBOT_EMERGENCY_STOP"
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"
    assert ask(controller, "power on") == "Powering on"
    time.sleep(0.4)  # longer than the power takes to come on
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"
    controller.admin.clear()
    assert ask(controller, "safetystatus") == "Safetystatus: NORMAL"
    assert ask(controller, "robotmode") == "Robotmode: POWER_OFF"


def test_an_endless_line_ends_the_connection(controller: RunningController):
    with socket.create_connection((controller.host, 29999), timeout=10.0) as connection:
        connection.recv(100)
        connection.sendall(b"x" * 10_000)
        with contextlib.suppress(ConnectionResetError):  # if the line arrived in parts
            assert connection.recv(100) == b""
