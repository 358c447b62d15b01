"""Helpers for tests of the virtual controller: its log since a time, and waiting for a condition."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from cell.simulation.ur_controller.admin_client import AdminClient

HOME_Q_RAD = np.deg2rad((0.0, -90.0, 90.0, -90.0, -90.0, 0.0))
FAST = 10.0
"""Time factor of the fast controller."""
PATIENCE_S = 20.0
"""Timeout of `wait_for`, seconds. It is long because the machine may be busy."""

T = TypeVar("T")


def wait_for(condition: Callable[[], T], what: str) -> T:
    """Wait until a condition is true and return its value."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < deadline_s, f"timeout after {PATIENCE_S:g} s: {what}"
        time.sleep(0.005)
    return value


class LogSince:
    """Events of the controller since the creation of this object."""

    def __init__(self, admin: AdminClient) -> None:
        self._admin = admin
        self._first = admin.state().events

    def events(self, kind: str) -> list[dict[str, Any]]:
        """Return the events of one kind, oldest first."""
        return [event for event in self._admin.log(self._first) if event["kind"] == kind]

    def kinds(self, *of: str) -> list[str]:
        """Return the kinds of the events that are among `of`, in order."""
        return [event["kind"] for event in self._admin.log(self._first) if event["kind"] in of]

    def wait(self, kind: str) -> dict[str, Any]:
        """Wait for the first event of a kind and return it."""
        return wait_for(lambda: self.events(kind), f"an event {kind!r}")[0]
