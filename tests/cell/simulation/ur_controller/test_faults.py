"""Injected faults, as clients and the log see them."""

import socket
import struct
import time

import numpy as np
import pytest
from universal_robots_clients import dashboard_client

from cell.kinematics.ur_kinematics import forward
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.simulation.ur_controller import wheel
from tests.cell.simulation.ur_controller.cell_log import HOME_Q_RAD, LogSince, wait_for
from tests.cell.simulation.ur_controller.rtde_client import RtdeClient

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

AWAY_Q_RAD = (HOME_Q_RAD + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])).tolist()

_MOVE = wheel.CONNECT + 'control.moveJ(arguments["q"], 1.05, 1.4, True)\n'


def streaming(controller: RunningController, *names: str) -> RtdeClient:
    client = RtdeClient(controller.host)
    client.outputs(["timestamp", *names])
    client.start()
    client.data()
    return client


def test_drop_resets_every_rtde_connection_once(controller: RunningController):
    with streaming(controller) as first, streaming(controller) as second:
        controller.admin.drop()
        for client in (first, second):
            with pytest.raises(ConnectionResetError):
                client.drain()
    with streaming(controller) as third:
        third.data()
    assert dashboard_client.send_command(controller.host, "robotmode") == "Robotmode: RUNNING"


def test_frozen_rtde_is_silent_in_both_directions_until_cleared(controller: RunningController):
    log = LogSince(controller.admin)
    with streaming(controller) as client:
        recipe, _ = client.inputs(["input_int_register_0"])
        controller.admin.freeze()
        frozen_s = controller.admin.state().stamp_s
        client.write(recipe, "i", 34)
        client.socket.settimeout(0.3)
        with pytest.raises(TimeoutError):
            client.drain()
        assert log.events("command") == []
        assert dashboard_client.send_command(controller.host, "robotmode") == "Robotmode: RUNNING"
        client.socket.settimeout(10.0)
        controller.admin.clear()
        client.data()
        # Data that were sent meanwhile arrive late, as after a reconnected cable.
        assert log.wait("command")["stamp_s"] - frozen_s > 0.3


@pytest.mark.parametrize("port", [30004, 30003, 29999])
def test_half_open_ports_accept_and_never_answer(controller: RunningController, port: int):
    controller.admin.half_open()
    with socket.create_connection((controller.host, port), timeout=0.3) as connection:
        connection.sendall(struct.pack(">HBH", 5, ord("V"), 2) if port == 30004 else b"robotmode\n")
        with pytest.raises(TimeoutError):
            connection.recv(1)
        controller.admin.clear()
        connection.settimeout(10.0)
        with pytest.raises(ConnectionResetError):  # the data of the client are never read
            connection.recv(1)
    assert dashboard_client.send_command(controller.host, "robotmode") == "Robotmode: RUNNING"


def test_unreachable_refuses_new_connections_and_resets_others(controller: RunningController):
    with streaming(controller) as client:
        controller.admin.unreachable()
        with pytest.raises(ConnectionResetError):
            client.drain()
    for port in (30004, 30003, 29999):
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((controller.host, port), timeout=5.0)
    controller.admin.unreachable()  # a repetition has no effect
    controller.admin.clear()
    with streaming(controller):
        pass


def test_delayed_packages_are_late(controller: RunningController):
    def lag_s(client: RtdeClient) -> float:
        """Return the least delay of the data, up to the offset of the start of the controller, seconds."""
        return min(time.monotonic() - client.data()["timestamp"] for _ in range(50))

    with streaming(controller) as client:
        usual_s = lag_s(client)
        controller.admin.slow(delay_s=0.4)
        time.sleep(0.2)
        while time.monotonic() - client.data()["timestamp"] - usual_s < 0.3:
            pass  # sent before and read late
        assert lag_s(client) - usual_s == pytest.approx(0.4, abs=0.15)


def test_a_reduced_rate_sends_fewer_packages(controller: RunningController):
    with streaming(controller) as client:
        controller.admin.slow(rate_hz=20.0)
        stamps = [client.data()["timestamp"]]
        while stamps[-1] - stamps[0] < 0.5 or len(stamps) < 5:
            stamps.append(client.data()["timestamp"])
        assert np.diff(stamps[-4:]).min() > 0.04


def test_a_protective_stop_at_a_share_of_the_move_pauses_program_and_move(controller: RunningController):
    log = LogSince(controller.admin)
    controller.admin.protective_stop(at_share=0.5)
    seen = wheel.run(
        controller.host,
        _MOVE
        + """
while not receive.isProtectiveStopped(): time.sleep(0.002)
while any(receive.getActualQd()): time.sleep(0.002)
answer(safety=receive.getSafetyMode(), bits=receive.getSafetyStatusBits(), robot=receive.getRobotMode(),
       runtime=receive.getRuntimeState(), q=receive.getActualQ(), move=control.moveJ(arguments["q"], 1.05, 1.4, True))
""",
        q=AWAY_Q_RAD,
    )
    start, stop, still = (log.events(kind)[0] for kind in ("motion_start", "safety", "still"))
    assert stop["details"]["mode"] == "PROTECTIVE_STOP"
    assert stop["stamp_s"] - start["stamp_s"] == pytest.approx(0.5 * start["details"]["duration_s"], abs=1e-6)
    assert still["stamp_s"] - stop["stamp_s"] == pytest.approx(1.05 / 25.0, abs=1e-6)
    assert still["details"]["q_rad"][0] == pytest.approx(0.5 + 1.05**2 / (2 * 25.0), abs=1e-6)
    assert (seen["safety"], seen["robot"], seen["runtime"]) == (3, 7, 4)
    assert seen["bits"] == 1 << 2 | 1 << 10
    assert not seen["move"]
    assert controller.admin.state().program_state == "PAUSED"


def test_an_unlocked_program_continues_its_old_move_when_played(
    controller: RunningController,
):
    """Only `stop` ends a paused program, which is the reason for the stop command of the driver."""
    log, answers = LogSince(controller.admin), []
    controller.admin.protective_stop(at_share=0.5)
    with wheel.Talk(controller.host, _MOVE + 'say("moving")', q=AWAY_Q_RAD):
        log.wait("still")

    def ask(command: str) -> str:
        return dashboard_client.send_command(controller.host, command)

    def unlocked() -> bool:
        answers.append(ask("unlock protective stop"))
        return answers[-1] == "Protective stop releasing"

    assert ask("safetymode") == "Safetymode: PROTECTIVE_STOP"
    assert ask("programState") == "PAUSED rtde_control"
    assert ask("play") == "Failed to execute: play"
    wait_for(unlocked, "the stop can be unlocked")
    stopped_s = log.events("safety")[0]["stamp_s"]
    asked_s = [event["stamp_s"] for event in log.events("dashboard") if "unlock" in event["details"]["command"]]
    assert len(asked_s) > 1
    assert max(asked_s[:-1]) - stopped_s < 5.0 <= asked_s[-1] - stopped_s
    assert all(answer.startswith("Cannot unlock protective stop until 5s") for answer in answers[:-1])
    assert ask("safetymode") == "Safetymode: NORMAL"
    assert ask("close safety popup") == "closing safety popup"
    assert ask("programState") == "PAUSED rtde_control"
    assert len(log.events("motion_start")) == 1
    assert ask("play") == "Starting program"
    np.testing.assert_array_equal(log.wait("motion_done")["details"]["q_rad"], AWAY_Q_RAD)
    assert len(log.events("command")) == 1
    assert ask("stop") == "Stopped"


def test_a_program_stopped_in_a_protective_stop_does_not_continue(controller: RunningController):
    log = LogSince(controller.admin)
    controller.admin.protective_stop(at_share=0.5)
    with wheel.Talk(controller.host, _MOVE + 'say("moving")', q=AWAY_Q_RAD):
        log.wait("still")
    assert dashboard_client.stop_program(controller.host) == "Stopped"
    assert controller.admin.state().program_state == "STOPPED"
    assert dashboard_client.play_program(controller.host) == "Failed to execute: play"
    assert log.events("motion_done") == []
    assert not controller.admin.state().moving


def test_a_scheduled_stop_occurs_at_its_time(controller: RunningController):
    log = LogSince(controller.admin)
    controller.admin.protective_stop(after_s=0.25)
    asked_s = log.wait("fault")["stamp_s"]
    assert log.wait("safety")["stamp_s"] - asked_s == pytest.approx(0.25, abs=1e-6)
    controller.admin.reset()
    controller.admin.protective_stop(after_s=1.0)
    controller.admin.clear()  # a second is enough for it, also on a busy machine
    time.sleep(1.1)
    assert len(log.events("safety")) == 2  # the stop and its end


def test_the_safety_plane_stops_an_arm_below_it(controller: RunningController):
    controller.admin.table(0.40)
    log = LogSince(controller.admin)
    below = (HOME_Q_RAD + np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])).tolist()
    wheel.run(
        controller.host,
        _MOVE + "\nwhile not receive.isProtectiveStopped(): time.sleep(0.002)\nanswer()",
        q=below,
    )
    assert "below the plane at 0.400 m" in log.wait("safety")["details"]["cause"]
    log.wait("still")
    # The arm brakes one or two cycles later. A controller that comes late makes them up, so the arm is lower then.
    assert forward("ur5e", below)[2, 3] + 0.01 < controller.admin.pose()[2, 3] < 0.40
    assert log.events("motion_done") == []


def test_a_move_beyond_the_joint_limits_is_stopped_at_them(controller: RunningController):
    log = LogSince(controller.admin)
    controller.admin.reset([6.2, *HOME_Q_RAD[1:]])
    wheel.run(
        controller.host,
        _MOVE + "\nwhile not receive.isProtectiveStopped(): time.sleep(0.002)\nanswer()",
        q=[7.0, *HOME_Q_RAD[1:]],
    )
    causes = [event["details"]["cause"] for event in log.events("safety")]
    assert "joint 1 at 363" in causes[-1] or "joint 1 at 364" in causes[-1]


def test_an_emergency_stop_during_a_move_ends_the_program_and_the_power(controller: RunningController):
    log = LogSince(controller.admin)
    with wheel.Talk(controller.host, _MOVE + 'say("moving")', q=AWAY_Q_RAD) as talk:
        talk.hear("moving")
        log.wait("motion_start")
        controller.admin.emergency_stop()
        log.wait("still")
    state = controller.admin.state()
    assert (state.safety_mode, state.robot_mode, state.program_state) == (
        "ROBOT_EMERGENCY_STOP", "POWER_OFF", "STOPPED",
    )  # fmt: skip
    controller.admin.clear()
    assert controller.admin.state().robot_mode == "POWER_OFF"
    controller.admin.reset()
    assert controller.admin.state().robot_mode == "RUNNING"


@pytest.mark.parametrize("fault", ["power_off", "local_mode", "protective_stop", "emergency_stop"])
def test_no_program_is_started_during_a_fault(controller: RunningController, fault: str):
    getattr(controller.admin, fault)()
    log = LogSince(controller.admin)
    with socket.create_connection((controller.host, 30003), timeout=5.0) as connection:
        connection.sendall(b"def rtde_control():\n  sync()\nend\n")
        refused = log.wait("script_refused")
    assert refused["details"]["name"] == "rtde_control"
    assert refused["details"]["reason"]
    assert log.events("script_upload") == []


def test_a_dashboard_stop_acts_at_once_and_is_answered_at_rest(controller: RunningController):
    log = LogSince(controller.admin)
    with wheel.Talk(controller.host, _MOVE + 'say("moving")', q=[3.0, *HOME_Q_RAD[1:]]) as talk:
        talk.hear("moving")
        wait_for(lambda: controller.admin.state().qd_rad_s[0] > 1.0, "full speed")
        sent_s = time.monotonic()
        assert dashboard_client.stop_program(controller.host, timeout=20.0) == "Stopped"
        answered_s = time.monotonic()
    braking, still = log.events("braking")[0], log.events("still")[0]
    assert sent_s <= braking["stamp_s"] <= still["stamp_s"] <= answered_s
    assert still["stamp_s"] - braking["stamp_s"] == pytest.approx(1.05 / 15.0, rel=0.05)
    assert log.kinds("motion_done") == []
