"""The driver in its child process, with the real ur_rtde against the virtual controller."""

import contextlib
import signal
import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.arm.preflight import RTDE_PORT
from cell.arm.rtde_driver import SILENCE_S, Silence, UrDriver, _not_connected, same_pose
from cell.arm.rtde_state import RtdeState, decode_safety_mode
from cell.errors import RobotLostError, RobotNotReadyError, RobotUnreachableError, StoppedError
from cell.process.child import Child, ChildLostError
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.pendant import Pendant
from tests.cell.arm.virtual_arm import HOME, far, fresh, kinds, motion_commands, moving, until
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

ANSWER_S = 20.0
"""Time limit for the start of Python and the connection on a busy machine, seconds."""
HZ = 2.5


@pytest.fixture
def driver(controller: RunningController) -> Iterator[Child]:
    fresh(controller)
    child = Child("arm", UrDriver, controller.host, HZ)
    child.call("poll", timeout_s=ANSWER_S)
    yield child
    child.close()


def test_the_driver_reads_the_state_of_the_controller(controller: RunningController, driver: Child):
    reading: RtdeState = driver.call("poll", timeout_s=ANSWER_S)
    assert (reading.robot_mode, reading.safety_mode, reading.program) == ("running", "normal", "playing")
    assert reading.connected
    assert not reading.operating
    assert reading.speed_fraction == 1.0
    np.testing.assert_allclose(reading.q_rad, HOME, atol=1e-9)

    def is_newer() -> bool:
        later: RtdeState = driver.call("poll", timeout_s=ANSWER_S)
        return later.controller_s > reading.controller_s + 0.05 and later.age_s < 0.1

    # The clock of the controller advances, with 125 updates per second.
    until(is_newer, 10.0)


def test_a_tool_set_at_the_pendant_is_read_with_its_pose(controller: RunningController):
    fresh(controller)
    tool = (0.02, -0.03, 0.17, 0.3, -0.2, 0.5)
    setter = Child("tool", Pendant, controller.host)
    setter.call("set_tool", tool, timeout_s=ANSWER_S)
    setter.close()
    until(lambda: controller.admin.state().connections["rtde"] == 0, 5.0)
    driver = Child("arm", UrDriver, controller.host, HZ)
    try:
        reading, read_tool = driver.call("at_rest", timeout_s=ANSWER_S)
    finally:
        driver.close()
    np.testing.assert_allclose(read_tool, tool, atol=1e-9)
    T_base_tcp = from_rotation_vector(reading.base_tcp[:3], reading.base_tcp[3:])
    T_base_flange = controller.admin.state().T_base_flange
    T_flange_tcp = from_rotation_vector(tool[:3], tool[3:])
    np.testing.assert_allclose(T_base_tcp, T_base_flange @ T_flange_tcp, atol=1e-9)


def test_other_calls_return_during_a_move(controller: RunningController, driver: Child):
    begin = controller.admin.state().events
    before = driver.call("start_move", tuple(far(0.3).tolist()), 1.0, 2.0, timeout_s=ANSWER_S)
    update_state: list[RtdeState] = []

    def ended() -> bool:
        update_state.append(driver.call("poll", timeout_s=ANSWER_S))
        return update_state[-1].operation != before and not update_state[-1].operating

    until(ended, 10.0)
    assert any(reading.operating and 0.05 < reading.q_rad[0] < 0.25 for reading in update_state)
    np.testing.assert_allclose(update_state[-1].q_rad, far(0.3), atol=1e-3)
    (command,) = motion_commands(controller.admin.log(begin))
    assert command["details"]["asynchronous"]
    assert (command["details"]["speed"], command["details"]["acceleration"]) == (1.0, 2.0)


def test_after_a_stop_this_process_sends_no_move(controller: RunningController, driver: Child):
    driver.call("start_move", tuple(far().tolist()), 1.0, 2.0, timeout_s=ANSWER_S)
    moving(controller, share=0.02)
    driver.call("stop", 4.0, timeout_s=ANSWER_S)
    begin = controller.admin.state().events
    with pytest.raises(StoppedError):
        driver.call("start_move", tuple(HOME.tolist()), 1.0, 2.0, timeout_s=ANSWER_S)
    until(lambda: not controller.admin.state().moving, 5.0)
    assert not motion_commands(controller.admin.log(begin))


def test_between_moves_the_driver_serves_the_watchdog_without_the_parent(controller: RunningController, driver: Child):
    begin = controller.admin.state().events
    time.sleep(3.0 / HZ)
    assert controller.admin.state().program_state == "PLAYING"
    assert not kinds(controller.admin.log(begin), "watchdog_expired")


def test_the_driver_does_not_serve_the_watchdog_for_a_silent_parent(controller: RunningController):
    begin = fresh(controller)
    child = Child("arm", UrDriver, controller.host, HZ, ANSWER_S, 0.5)
    try:
        child.call("poll", timeout_s=ANSWER_S)
        until(lambda: bool(kinds(controller.admin.log(begin), "watchdog_expired")), 10.0)
        until(lambda: child.call("poll", timeout_s=ANSWER_S).program == "stopped", 5.0)
    finally:
        child.close()


def test_during_a_move_only_polls_of_the_parent_serve_the_watchdog(controller: RunningController, driver: Child):
    begin = controller.admin.state().events
    driver.call("start_move", tuple(far().tolist()), 1.0, 2.0, timeout_s=ANSWER_S)
    until(lambda: bool(kinds(controller.admin.log(begin), "watchdog_expired")), 10.0)
    until(lambda: not controller.admin.state().moving, 5.0)
    assert controller.admin.state().q_rad[0] < 1.5


def test_the_longest_silence_is_kept_until_the_end_of_the_program_is_seen():
    silence = Silence(10.0)
    for now_s in (10.1, 10.2, 10.7, 10.8):
        silence.end(now_s)
    assert silence.longest(10.85, playing=True) == pytest.approx(0.5)
    assert silence.longest(11.4, playing=True) == pytest.approx(0.6)  # not ended yet
    silence.end(11.4)
    later_s = 11.4
    while later_s < 11.4 + SILENCE_S + 0.2:
        later_s += 0.1
        silence.end(later_s)
    assert silence.longest(later_s, playing=True) == pytest.approx(0.1)


def test_nothing_is_sent_after_the_end_of_a_program_and_that_is_no_silence():
    silence = Silence(10.0)
    silence.end(10.1)
    assert silence.longest(10.15, playing=False) == pytest.approx(0.1)
    assert silence.longest(14.0, playing=False) == pytest.approx(0.1)


def test_a_broken_connection_is_not_restored(controller: RunningController, driver: Child):
    """ur_rtde would reconnect, upload its script and repeat its last command."""
    driver.call("start_move", tuple(far().tolist()), 1.0, 2.0, timeout_s=ANSWER_S)
    moving(controller, share=0.02)
    begin = controller.admin.state().events
    controller.admin.drop()
    # The loss appears in the state or as an error, depending on the time. In about one of a hundred runs, the threads
    # of ur_rtde crash, which is a reason for the separate process.
    with contextlib.suppress(RobotLostError, ChildLostError):
        until(lambda: not driver.call("poll", timeout_s=ANSWER_S).connected, 5.0)
    time.sleep(0.5)  # reconnecting takes ur_rtde about 50 ms
    events = controller.admin.log(begin)
    assert not kinds(events, "connected", "script_upload", "command")


def test_a_hanging_constructor_that_holds_the_gil_is_killed():
    host = free_host()
    with socket.create_server((host, RTDE_PORT)):
        child = Child("arm", UrDriver, host, HZ, 0.3)
        with pytest.raises(ChildLostError, match=rf"exit code -{signal.SIGALRM.value}"):
            child.call("poll", timeout_s=ANSWER_S)
        child.close()


def test_an_unreachable_robot_is_reported():
    child = Child("arm", UrDriver, free_host(), HZ)
    with pytest.raises(RobotUnreachableError, match="connecting to the robot at"):
        child.call("poll", timeout_s=ANSWER_S)
    child.close()


def test_a_second_driver_of_a_robot_is_refused(controller: RunningController, driver: Child):
    other = Child("arm", UrDriver, controller.host, HZ)
    try:
        with pytest.raises(RobotNotReadyError, match="something else writes the robot's RTDE registers"):
            other.call("poll", timeout_s=ANSWER_S)
    finally:
        other.close()


def test_the_safety_bits_precede_the_safety_mode():
    assert decode_safety_mode(1, 0b1) == "normal"
    assert decode_safety_mode(2, 0b10) == "reduced"
    assert decode_safety_mode(1, 0b101) == "protective_stop"
    assert decode_safety_mode(1, 1 << 6 | 1 << 7) == "robot_emergency_stop"
    assert decode_safety_mode(3, 0b1) == "protective_stop"
    assert decode_safety_mode(99, 0) == "undefined"
    assert {decode_safety_mode(kind, 0) for kind in (5, 12, 13, 14)} == {"safeguard_stop"}


def test_poses_with_opposite_half_turns_are_equal():
    down = (0.1, -0.4, 0.3, np.pi - 1e-5, 1e-5, 0.0)
    assert same_pose(down, (0.1, -0.4, 0.3, 1e-5 - np.pi, 1e-5, 0.0))
    assert same_pose((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), (0.1, 0.0, 1e-4, 1e-4, 0.0, 0.0))
    for shifted in ((0.102, *down[1:]), (*down[:3], np.pi - 0.01, 0.0, 0.0), (*down[:3], 0.0, np.pi, 0.0)):
        assert not same_pose(down, shifted)


@pytest.mark.parametrize(
    ("said", "error"),
    [
        ("One of the RTDE input registers are already in use!", RobotNotReadyError),
        ("ur_rtde: Please enable remote control on the robot!", RobotNotReadyError),
        ("ur_rtde: Failed to start control script, before timeout of 5 seconds", RobotNotReadyError),
        ("anything else", RobotUnreachableError),
    ],
)
def test_messages_of_the_vendor_become_our_errors(said: str, error: type[Exception]):
    assert type(_not_connected("10.0.0.7", said)) is error
