"""Helpers for tests of the arm: the virtual controller and its log."""

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
"""Settings for tests that do not measure the speed of the flange."""
MOTION_COMMANDS = {
    "movej", "movej_ik", "movel", "movel_fk", "move_path", "servoj", "servol", "servoc", "speedj", "speedl",
    "force_mode", "start_jog", "move_until_contact", "freedrive_mode", "teach_mode",
}  # fmt: skip


def far(turn_rad: float = 2.0) -> np.ndarray:
    """Return joint angles (6,) with the first joint turned by `turn_rad` from HOME."""
    return HOME + [turn_rad, 0.0, 0.0, 0.0, 0.0, 0.0]


def fresh(controller: RunningController) -> int:
    """Reset the controller, with the arm at HOME, and return the number of the next event of its log."""
    controller.admin.reset(HOME)
    until(lambda: controller.admin.state().program_state == "STOPPED", 5.0)
    return controller.admin.state().events


def until(true: Callable[[], bool], timeout_s: float) -> None:
    """Wait until a condition is true."""
    limit_s = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < limit_s, "timeout"
        time.sleep(0.01)


def kinds(events: list[dict[str, Any]], *wanted: str) -> list[dict[str, Any]]:
    """Return the events of some kinds."""
    return [event for event in events if event["kind"] in wanted]


def motion_commands(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the commands that move the arm."""
    return [event for event in kinds(events, "command") if event["details"]["name"] in MOTION_COMMANDS]


def dashboard_commands(events: list[dict[str, Any]]) -> list[str]:
    """Return the commands to the dashboard, in order."""
    return [event["details"]["command"] for event in kinds(events, "dashboard")]


def stops(events: list[dict[str, Any]]) -> list[float]:
    """Return the times at which stops arrived, by RTDE or by the dashboard (monotonic seconds)."""
    return [
        event["stamp_s"]
        for event in events
        if (event["kind"] == "command" and event["details"]["name"] in ("stopj", "stopl", "stop_script"))
        or (event["kind"] == "dashboard" and event["details"]["command"] == "stop")
    ]


def moving(controller: RunningController, share: float = 0.1) -> None:
    """Wait until more than a share of a move is done."""
    until(lambda: (state := controller.admin.state()).moving and state.progress > share, 10.0)


@contextmanager
def thread_of(action: Callable[[], Any]) -> Iterator[list[Any]]:
    """Run an action in a thread. After the block, the list has its result or error, and the time of its end."""
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
