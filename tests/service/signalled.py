"""Interrupt a command that moves the arm, and check that its controller stopped the arm."""

import signal
import subprocess
from typing import Any

from cell.simulation.ur_controller.admin_client import AdminClient
from tests.cell.arm.virtual_arm import motion_commands, stops


def interrupt(
    running: subprocess.Popen[str], host: str, number: signal.Signals, timeout_s: float
) -> tuple[str, str, list[dict[str, Any]]]:
    """Send the signal, wait for the end, and return stdout, stderr and the later events of the controller."""
    controller = AdminClient(host)
    begin = controller.state().events
    running.send_signal(number)
    events: list[dict[str, Any]] = []
    try:  # ends when the command closes the controller
        while running.poll() is None:
            events = controller.log(begin)
    except OSError:
        pass
    controller.close()
    out, err = running.communicate(timeout=timeout_s)
    return out, err, events


def assert_stopped(events: list[dict[str, Any]]) -> None:
    """Check that the arm was stopped and did not move again."""
    stop_times_s = stops(events)
    assert stop_times_s, f"the arm was not stopped: {events}"
    assert not [event for event in motion_commands(events) if event["stamp_s"] > stop_times_s[0]]
