"""What tests of the arm share: a virtual controller, and what its log tells."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from cell.config.arm_config import SimulatedArm
from cell.errors import CellError
from cell.simulation.ur_controller.launcher import RunningController

HOME = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
FAST = SimulatedArm(speed_rad_s=1.5, acceleration_rad_s2=3.0, flange_speed_m_s=2.0)
"""For tests that are not about the flange's speed."""
MOTION_COMMANDS = {
    "movej", "movej_ik", "movel", "movel_fk", "move_path", "servoj", "servol", "servoc", "speedj", "speedl",
    "force_mode", "start_jog", "move_until_contact", "freedrive_mode", "teach_mode",
}  # fmt: skip


def far(turn_rad: float = 2.0) -> np.ndarray:
    """Joint angles a turn of the first joint away from HOME."""
    return HOME + [turn_rad, 0.0, 0.0, 0.0, 0.0, 0.0]


def fresh(controller: RunningController) -> int:
    """The controller as after a good night, arm at HOME; the number of the next event of its log."""
    controller.admin.reset(HOME)
    until(lambda: controller.admin.state().program_state == "STOPPED", 5.0)
    return controller.admin.state().events


def until(true: Callable[[], bool], timeout_s: float) -> None:
    """Waits for something to become true."""
    limit_s = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < limit_s, "it did not happen"
        time.sleep(0.01)


def kinds(events: list[dict[str, Any]], *wanted: str) -> list[dict[str, Any]]:
    """The events of some kinds."""
    return [event for event in events if event["kind"] in wanted]


def motion_commands(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The commands that set the arm in motion."""
    return [event for event in kinds(events, "command") if event["details"]["name"] in MOTION_COMMANDS]


def dashboard_commands(events: list[dict[str, Any]]) -> list[str]:
    """What was sent to the dashboard, in order."""
    return [event["details"]["command"] for event in kinds(events, "dashboard")]


def stops(events: list[dict[str, Any]]) -> list[float]:
    """When stops arrived, over whichever way."""
    return [
        event["stamp_s"]
        for event in events
        if (event["kind"] == "command" and event["details"]["name"] in ("stopj", "stopl", "stop_script"))
        or (event["kind"] == "dashboard" and event["details"]["command"] == "stop")
    ]


def moving(controller: RunningController, share: float = 0.1) -> None:
    """Waits until a move is under way."""
    until(lambda: (state := controller.admin.state()).moving and state.progress > share, 10.0)


@contextmanager
def thread_of(action: Callable[[], Any]) -> Iterator[list[Any]]:
    """Runs an action in a thread; what it returned or raised, and when, is in the list after the block."""
    result: list[Any] = []

    def run() -> None:
        try:
            result.append(action())
        except CellError as error:
            result.append(error)
        result.append(time.monotonic())

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield result
    finally:
        thread.join(20.0)
    assert not thread.is_alive()
