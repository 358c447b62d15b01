"""What the tests of the virtual controller share: the log since a moment, and waiting for something."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from cell.simulation.ur_controller.admin_client import AdminClient

HOME_Q_RAD = np.deg2rad((0.0, -90.0, 90.0, -90.0, -90.0, 0.0))
FAST = 10.0
"""Time factor of the fast controller."""
PATIENCE_S = 20.0
"""For what takes no time on a machine that has nothing else to do."""

T = TypeVar("T")


def wait_for(condition: Callable[[], T], what: str) -> T:
    """The condition's value as soon as it is true."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < deadline_s, f"waited {PATIENCE_S:g} s in vain: {what}"
        time.sleep(0.005)
    return value


class LogSince:
    """The controller's events from the moment on at which this is made."""

    def __init__(self, admin: AdminClient) -> None:
        self._admin = admin
        self._first = admin.state().events

    def events(self, kind: str) -> list[dict[str, Any]]:
        """Those of one kind, oldest first."""
        return [event for event in self._admin.log(self._first) if event["kind"] == kind]

    def kinds(self, *of: str) -> list[str]:
        """Which of these kinds came, in order."""
        return [event["kind"] for event in self._admin.log(self._first) if event["kind"] in of]

    def wait(self, kind: str) -> dict[str, Any]:
        """The first event of that kind, awaited."""
        return wait_for(lambda: self.events(kind), f"an event {kind!r}")[0]
