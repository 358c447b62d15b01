"""A command line that moves the arm is told to end by a signal; what its controller saw of it."""

import signal
import subprocess
from typing import Any

from cell.simulation.ur_controller.admin_client import AdminClient
from tests.cell.arm.virtual_arm import motion_commands, stops


def told_to_end(
    running: subprocess.Popen[str], host: str, number: signal.Signals, timeout_s: float
) -> tuple[str, str, list[dict[str, Any]]]:
    """Sends the signal; stdout and stderr of what ends by it, and the controller's events from then on."""
    controller = AdminClient(host)
    begin = controller.state().events
    running.send_signal(number)
    seen: list[dict[str, Any]] = []
    try:  # until the controller is let go
        while running.poll() is None:
            seen = controller.log(begin)
    except OSError:
        pass
    controller.close()
    out, said = running.communicate(timeout=timeout_s)
    return out, said, seen


def assert_stopped(seen: list[dict[str, Any]]) -> None:
    """The arm was stopped, and nothing set it in motion again."""
    arrived = stops(seen)
    assert arrived, f"the arm was not stopped: {seen}"
    assert not [event for event in motion_commands(seen) if event["stamp_s"] > arrived[0]]
