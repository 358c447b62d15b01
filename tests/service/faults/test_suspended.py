"""The whole service is suspended during a move. The controller stops the arm, and nothing moves it again."""

import re
import signal
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest

from cell.simulation.ur_controller.admin_client import AdminClient
from tests.cell.arm.virtual_arm import kinds, motion_commands, until
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.faults.figures import Figures, rounds
from tests.service.service_process import process

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

STOOD_STILL = re.compile(
    r"because this (service|computer) stood still for (at least )?\d\.\d s\. The network is not the cause"
)
WATCHDOG_HZ = 2.5
TIME_FACTOR = 0.5
"""Factor of the arm's speed. A move takes several times as long as the watchdog waits."""


@pytest.mark.xdist_group("service")  # one at a time: several busy processes
@pytest.mark.fault(12)
@rounds(1, 10)
def test_the_watchdog_stops_the_arm_and_nothing_resumes(
    tmp_path: Path, finished: Finished, figures: Figures, count: int
) -> None:
    expired_s, host = [], free_host()
    variables = {
        "POINTCHAIN_ARM__HOST": host,
        "POINTCHAIN_ARM__TIME_FACTOR": str(TIME_FACTOR),
        "POINTCHAIN_ARM__WATCHDOG_HZ": str(WATCHDOG_HZ),
        "POINTCHAIN_CAMERA__MODEL": "exact",
        "POINTCHAIN_CAMERA__EXPOSURES": "1",
    }
    with process(tmp_path / "data", tmp_path / "log", **variables) as (service, client):
        for _ in range(count):
            answer = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042, "views": 2})
            assert answer.status_code == 202, answer.text
            location = answer.headers["Location"]
            wait_until(lambda location=location: client.get(location).json()["state"] == "scanning")
            with closing(AdminClient(host)) as controller:
                wait_for_long_move(controller)
                since = controller.state().events
                service.send_signal(signal.SIGSTOP)
                suspended_s = time.monotonic()
                try:
                    wait_until_still(controller, since)
                finally:
                    service.send_signal(signal.SIGCONT)
                events = controller.log(since)
                (expired,) = kinds(events, "watchdog_expired")
                # The time in which the controller itself could not run on this machine does not count.
                expired_s.append(expired["stamp_s"] - suspended_s - expired["details"]["excused_s"])
                assert not kinds(events, "motion_done"), "the arm completed its move"
                scan = finished(client, location)
                assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:robot-lost")
                assert STOOD_STILL.search(scan["problem"]["detail"]), scan["problem"]["detail"]
                wait_until(lambda: client.get("/api/cell").json()["state"] == "fault")
                time.sleep(0.5)  # a move that resumed by itself would have begun by now
                events = controller.log(since)
                assert not motion_commands(events)
                assert not kinds(events, "motion_start", "script_upload")
                assert not controller.state().moving
            assert client.post("/api/cell/acknowledge").status_code == 200
    figures.at_most("stopped by the controller", expired_s, 1.1 / WATCHDOG_HZ)


def wait_until_still(controller: AdminClient, since: int) -> None:
    """Wait until the arm is at rest."""
    until(lambda: bool(kinds(controller.log(since), "still")), 10.0)


def wait_for_long_move(controller: AdminClient) -> None:
    """Wait for a move whose remaining time exceeds twice the timeout of the watchdog."""

    def in_long_move() -> bool:
        state = controller.state()
        if not state.moving or state.progress < 0.1:
            return False
        move: dict[str, Any] = kinds(controller.log(max(0, state.events - 20)), "motion_start")[-1]
        return (1 - state.progress) * move["details"]["duration_s"] / TIME_FACTOR > 2 / WATCHDOG_HZ

    wait_until(in_long_move)
