"""Faults during a move: they are detected in time, the arm stops, and no move is continued automatically.

Times are those of the controller's log, or from the fault to the exception. Their limits are asserted.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cell.arm.ur_arm import UrArm
from cell.errors import (
    CellError,
    EmergencyStopError,
    MotionError,
    ProtectiveStopError,
    RobotLostError,
    RobotNotReadyError,
    RobotUnreachableError,
    StoppedError,
    TooEarlyError,
)
from cell.process.child import Child
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.virtual_arm import (
    FAST,
    HOME,
    dashboard_commands,
    far,
    fresh,
    kinds,
    motion_commands,
    moving,
    thread_of,
    until,
)
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

LOST_S = 0.5
"""Limit of the time until a lost robot is detected, seconds."""
PROTECTIVE_S = 0.1
"""Limit of the time until a protective stop is detected, seconds."""


@pytest.fixture
def arm(controller: RunningController) -> Iterator[UrArm]:
    """Yield a connected arm at HOME."""
    fresh(controller)
    arm = UrArm(FAST, controller.host)
    arm.connect()
    yield arm
    controller.admin.clear()
    arm.close()


def move_with_fault(
    controller: RunningController, arm: UrArm, cause_fault: Callable[[], Any], within_s: float
) -> tuple[BaseException, list[dict[str, Any]]]:
    """Cause a fault during a move, which must end `within_s`. Return its error and the later controller events.

    On a busy machine the error may be late once or twice, so there are three attempts.
    """
    took_s: list[float] = []
    while len(took_s) < 3:
        if took_s:
            fresh(controller)
            arm.connect()
        with thread_of(lambda: arm.move(far())) as result:
            moving(controller)
            begin = controller.admin.state().events
            caused_s = time.monotonic()
            cause_fault()
        error, noticed_s = result
        assert isinstance(error, CellError), f"the move returned {error}"
        took_s.append(noticed_s - caused_s)
        if took_s[-1] <= within_s:
            return error, controller.admin.log(begin)
    pytest.fail(f"detected after {took_s} s, the limit is {within_s:g} s")


def assert_ended(controller: RunningController, arm: UrArm, events: list[dict[str, Any]]) -> None:
    """Check that no move was sent again, the arm is at rest short of its target, and the program has ended."""
    until(lambda: not controller.admin.state().moving, 2.0)
    state = controller.admin.state()
    assert state.q_rad[0] < 1.6
    assert state.program_state == "STOPPED"
    assert not motion_commands(events)
    assert not kinds(events, "script_upload", "motion_start")
    with pytest.raises(CellError):
        arm.move(far())
    with pytest.raises(CellError):
        arm.check_ready()


@pytest.mark.parametrize("fault", ["drop", "freeze", "unreachable"])
def test_a_lost_link_ends_a_move(controller: RunningController, arm: UrArm, fault: str):
    error, events = move_with_fault(controller, arm, getattr(controller.admin, fault), LOST_S)
    assert isinstance(error, RobotLostError)
    time.sleep(0.2)  # ur_rtde would have reconnected by now
    controller.admin.clear()
    until(lambda: not controller.admin.state().moving, 2.0)
    assert_ended(controller, arm, events + controller.admin.log(events[-1]["index"] + 1))
    # After a person acknowledges, the arm moves from its present position.
    arm.acknowledge()
    arm.connect()
    arm.move(HOME)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_hanging_child_ends_a_move(controller: RunningController, arm: UrArm, number: signal.Signals):
    children: list[Child] = []

    def cause_fault() -> None:
        assert arm._link.child is not None
        children.append(arm._link.child)
        os.kill(children[-1].pid, number)

    error, events = move_with_fault(controller, arm, cause_fault, LOST_S)
    assert isinstance(error, RobotLostError)
    assert_ended(controller, arm, events)
    assert not any(child.alive for child in children)
    arm.connect()
    arm.move(HOME)


def test_an_interrupted_stop_still_ends_the_move(
    controller: RunningController, arm: UrArm, monkeypatch: pytest.MonkeyPatch
):
    """Ctrl-C may interrupt a stop that waits for another call. The thread that moves the arm must end the move."""

    def interrupted(*arguments: object, **named: object) -> None:
        raise KeyboardInterrupt

    with thread_of(lambda: arm.move(far())) as result:
        moving(controller)
        begin, child = controller.admin.state().events, arm._link.child
        assert child is not None
        call = child.call
        monkeypatch.setattr(
            child, "call", lambda *args, **of: (interrupted if args[0] == "stop" else call)(*args, **of)
        )
        with pytest.raises(KeyboardInterrupt):
            arm.stop()
    assert isinstance(result[0], StoppedError)
    assert_ended(controller, arm, controller.admin.log(begin))


def test_only_an_acknowledgement_ends_a_protective_stop(controller: RunningController, arm: UrArm):
    error, events = move_with_fault(controller, arm, controller.admin.protective_stop, PROTECTIVE_S)
    assert isinstance(error, ProtectiveStopError)
    stopped = kinds(events, "safety")[0]
    assert_ended(controller, arm, events)
    begin = controller.admin.state().events

    # Connecting does not unlock it.
    with pytest.raises(ProtectiveStopError):
        arm.connect()
    # The robot refuses to unlock for 5 s.
    for early_s in (2.0, 4.9):
        until(lambda early_s=early_s: time.monotonic() >= stopped["stamp_s"] + early_s, 10.0)
        with pytest.raises(TooEarlyError, match=r"try again in [0-9.]+ s"):
            arm.acknowledge()
    assert controller.admin.state().safety_mode == "PROTECTIVE_STOP"
    until(lambda: time.monotonic() >= stopped["stamp_s"] + 5.1, 10.0)
    arm.acknowledge()
    assert controller.admin.state().safety_mode == "NORMAL"
    events = controller.admin.log(begin)
    unlocks = [event for event in kinds(events, "dashboard") if "releasing" in event["details"]["answer"]]
    assert [event["details"]["command"] for event in unlocks] == ["unlock protective stop"]
    assert unlocks[0]["stamp_s"] - stopped["stamp_s"] >= 5.0
    assert "play" not in dashboard_commands(events)
    assert not kinds(events, "motion_start", "command", "script_upload")
    with pytest.raises(RobotNotReadyError, match="connect first"):
        arm.move(HOME)
    arm.connect()
    arm.move(HOME)


@pytest.mark.parametrize("order", ["before", "after"])
def test_a_requested_stop_does_not_hide_a_protective_stop(
    controller: RunningController, arm: UrArm, order: str, monkeypatch: pytest.MonkeyPatch
):
    """A paused program would finish its move if it were unlocked and played at the pendant."""
    # A late child would be killed and the program ended over the dashboard, so that no paused program is left.
    for limit in ("STOP_TURN_S", "STOP_ANSWER_S", "ANSWER_S"):
        monkeypatch.setattr(f"cell.arm.connection.{limit}", 10.0)
    # The thread of the move must not end it before both stops were caused.
    caused = threading.Event()
    end_stopped = arm._link._end_stopped
    monkeypatch.setattr(arm._link, "_end_stopped", lambda: caused.wait(10.0) and end_stopped())
    with thread_of(lambda: arm.move(far())) as result:
        moving(controller)
        begin = controller.admin.state().events
        stop_actions = [controller.admin.protective_stop, arm.stop]
        for cause_fault in stop_actions if order == "before" else reversed(stop_actions):
            cause_fault()
        until(lambda: controller.admin.state().safety_mode == "PROTECTIVE_STOP", 10.0)
        caused.set()
    assert isinstance(result[0], ProtectiveStopError)
    assert_ended(controller, arm, controller.admin.log(begin))


def test_a_new_service_cannot_unlock_a_protective_stop_too_early(controller: RunningController):
    """The service was restarted after the stop, so only the robot refuses."""
    begin = fresh(controller)
    controller.admin.protective_stop()
    arm = UrArm(FAST, controller.host)
    with pytest.raises(TooEarlyError, match="cannot be unlocked yet"):
        arm.acknowledge()
    controller.admin.local_mode()
    with pytest.raises(RobotNotReadyError, match="unlock it at its pendant"):
        arm.acknowledge()
    controller.admin.clear()
    assert not kinds(controller.admin.log(begin), "motion_start", "script_upload", "command")


def test_a_second_stop_that_nobody_noticed_is_waited_for_again(controller: RunningController, arm: UrArm):
    """A countdown of the first stop would have ended long ago."""
    move_with_fault(controller, arm, controller.admin.protective_stop, PROTECTIVE_S)
    noticed_s = time.monotonic()
    with pytest.raises(TooEarlyError):  # the connection ends here, and no later stop is noticed
        arm.acknowledge()
    until(lambda: time.monotonic() >= noticed_s + 5.3, 10.0)
    controller.admin.reset()
    controller.admin.protective_stop()
    with pytest.raises(TooEarlyError, match="cannot be unlocked yet") as refused:
        arm.acknowledge()
    assert refused.value.wait_s == 5.0
    controller.admin.clear()


def test_an_acknowledgement_without_a_fault_does_not_end_a_foreign_program(controller: RunningController):
    fresh(controller)
    controller.admin.foreign_program()
    arm = UrArm(FAST, controller.host)
    arm.acknowledge()
    assert controller.admin.state().program_state == "PLAYING"
    with pytest.raises(RobotUnreachableError):
        UrArm(FAST, free_host()).acknowledge()


def test_a_late_disconnection_does_not_end_a_foreign_program(controller: RunningController, arm: UrArm):
    """The watchdog ended our program while the robot was unreachable, so another program may run before it is known."""
    move_with_fault(controller, arm, controller.admin.unreachable, LOST_S)
    until(lambda: controller.admin.state().program_state == "STOPPED", 5.0)
    controller.admin.clear()
    controller.admin.foreign_program()
    arm.acknowledge()
    with pytest.raises(RobotNotReadyError, match=r"another program \(welding.urp\)"):
        arm.connect()
    assert controller.admin.state().program == "welding.urp"


@pytest.mark.parametrize(
    ("fault", "kind"),
    [("emergency_stop", EmergencyStopError), ("power_off", RobotNotReadyError)],
)
def test_an_emergency_stop_and_power_off_end_a_move(
    controller: RunningController, arm: UrArm, fault: str, kind: type[CellError]
):
    error, events = move_with_fault(controller, arm, getattr(controller.admin, fault), PROTECTIVE_S)
    assert isinstance(error, kind)
    assert_ended(controller, arm, events)
    with pytest.raises(kind):
        arm.connect()
    with pytest.raises(kind):
        arm.acknowledge()


def test_another_program_during_a_move_ends_the_move(controller: RunningController, arm: UrArm, monkeypatch):
    """The other program ends ours. A playing program does not prove that the move continues."""
    monkeypatch.setattr("cell.arm.motion.STALL_S", 0.5)
    error, events = move_with_fault(controller, arm, controller.admin.foreign_program, 5.0)
    assert isinstance(error, MotionError | RobotLostError)
    assert not motion_commands(events)
    assert not kinds(events, "script_upload", "motion_start")


def test_faults_of_an_arm_at_rest_are_detected(controller: RunningController, arm: UrArm):
    controller.admin.protective_stop()
    with pytest.raises(ProtectiveStopError):
        until(lambda: bool(arm.check_ready()), 2.0)
    assert arm.latest is not None
    assert arm.latest.safety_mode == "protective_stop"
    fresh(controller)
    arm.connect()
    controller.admin.freeze()
    time.sleep(0.5)
    with pytest.raises(RobotLostError):
        arm.state()


def test_a_slow_link_is_not_lost(controller: RunningController, arm: UrArm):
    controller.admin.slow(delay_s=0.03, rate_hz=50.0)
    arm.move(far(0.2))


def test_a_watchdog_that_fired_between_moves_ends_the_connection(controller: RunningController, arm: UrArm):
    begin = controller.admin.state().events
    child = arm._link.child
    assert child is not None
    os.kill(child.pid, signal.SIGSTOP)
    until(lambda: bool(kinds(controller.admin.log(begin), "watchdog_expired")), 5.0)
    os.kill(child.pid, signal.SIGCONT)
    with pytest.raises(RobotLostError):
        arm.move(far())
    assert not motion_commands(controller.admin.log(begin))


def in_time(expired: dict[str, Any], silent_from_s: float) -> bool:
    """Return whether the watchdog expired in time, without the time in which the controller process did not run."""
    late_s = expired["details"]["excused_s"]
    return expired["stamp_s"] - silent_from_s - late_s <= 1.1 / FAST.watchdog_hz


PARENT = """
import sys
sys.path.insert(0, {root!r})
from cell.arm.ur_arm import UrArm
from cell.errors import CellError
from tests.cell.arm.virtual_arm import FAST, far
arm = UrArm(FAST, {host!r})
arm.connect()
print("connected", flush=True)
try:
    arm.move(far())
except CellError as error:
    print(type(error).__name__, flush=True)
arm.close()
"""


def test_a_process_suspended_during_a_move_does_not_continue_it(controller: RunningController, tmp_path: Path):
    """The watchdog of the controller stops the arm. The resumed process does not continue the move."""
    begin = fresh(controller)
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(root=str(Path(__file__).parents[3]), host=controller.host))
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        try:
            assert parent.stdout.readline().strip() == "connected"
            moving(controller)
            parent.send_signal(signal.SIGSTOP)
            suspended_s = time.monotonic()
            until(lambda: not controller.admin.state().moving, 5.0)
            events = controller.admin.log(begin)
            (expired,) = kinds(events, "watchdog_expired")
            assert in_time(expired, suspended_s)
            assert controller.admin.state().q_rad[0] < 1.6
        finally:
            parent.send_signal(signal.SIGCONT)
        assert parent.stdout.readline().strip() == "RobotLostError"
        assert parent.wait(timeout=20.0) == 0
    assert len(motion_commands(controller.admin.log(begin))) == 1


def test_the_watchdog_stops_the_arm_of_a_killed_process(controller: RunningController, tmp_path: Path):
    begin = fresh(controller)
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(root=str(Path(__file__).parents[3]), host=controller.host))
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline().strip() == "connected"
        moving(controller)
        parent.kill()
        killed_s = time.monotonic()
    until(lambda: not controller.admin.state().moving, 5.0)
    (expired,) = kinds(controller.admin.log(begin), "watchdog_expired")
    assert in_time(expired, killed_s)
    # The child of the process has ended too.
    until(lambda: controller.admin.state().connections["rtde"] == 0, 5.0)
