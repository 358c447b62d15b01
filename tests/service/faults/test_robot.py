"""The robot is lost, makes a protective stop or is in local mode. The service detects it and resumes nothing."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import pytest

from tests.cell.arm.virtual_arm import dashboard_commands, kinds, motion_commands, stops
from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import Figures, rounds
from tests.service.faults.moves import (
    assert_followed_plan,
    events_since,
    log_position,
    time_to_rest_s,
    wait_for_event,
    wait_for_mid_move,
    wait_for_stop,
)
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

LOST_S = 0.5
"""Time limit until a lost robot is detected and its program is ended."""
PROTECTIVE_S = 0.1
"""Time limit until a protective stop is detected and the scan has failed."""
ALL_BUT_ONE = 0.98
"""Share for which the time limits hold: one of 50 may meet a busy machine."""
UNLOCK_S = 5.0
"""Time during which the robot refuses to unlock after a protective stop."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to catch in motion. Each test leaves it ready to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=5.0) as shared:
        yield shared


def start_scan_in_motion(cell: LiveCell, views: int) -> tuple[str, int]:
    """Start a scan and wait for a move after `views` recorded views.

    Returns:
        The address of the scan, and the number of its first event in the controller's log.
    """
    cell.is_well()
    begin, location = log_position(cell), cell.start()
    cell.wait_for_motion(location, views)
    wait_for_mid_move(cell)
    return location, begin


def assert_kept(cell: LiveCell, scan: dict[str, Any], min_views: int) -> None:
    """Assert that at least `min_views` views were recorded before the fault, and that they are kept."""
    count = [view["state"] for view in scan["progress"]["views"]].count("recorded")
    assert count >= min_views
    if count:
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == count


@pytest.mark.parametrize(
    "fault", [pytest.param("drop", marks=pytest.mark.fault(7)), pytest.param("freeze", marks=pytest.mark.fault(8))]
)
@rounds(1, 50)
@pytest.mark.problem("robot-lost")
def test_a_lost_robot_fails_the_scan_and_causes_a_fault(
    *, cell: LiveCell, finished: Finished, assert_problem: Problem, figures: Figures, fault: str, count: int
) -> None:
    detected = []
    for number in range(count):
        views = (number + 1) % 2
        location, begin = start_scan_in_motion(cell, views)
        since = log_position(cell)
        getattr(cell.controller, fault)()
        lost_s = wait_for_event(cell, since, lambda event: event["kind"] == "fault")
        detected.append(wait_for_stop(cell, since) - lost_s)
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:robot-lost")
        assert_kept(cell, scan, views)
        time_to_rest_s(cell, since, lost_s)  # fails if a motion began
        state = cell.state()
        assert (state["state"], state["robot"]["moving"]) == ("fault", None), "the motion of a lost robot is unknown"
        assert state["reason"].startswith("look at the cell and acknowledge first: ")
        assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
        assert_problem(cell.client.post("/api/cell/connect"), 409, "acknowledge-required")
        assert_problem(cell.client.post("/api/cell/release"), 409, "acknowledge-required")
        cell.controller.clear()
        assert cell.client.post("/api/cell/acknowledge").status_code == 200
        assert_followed_plan(cell, begin)
        assert not motion_commands(events_since(cell, since)), "a move was sent again"
        assert not events_since(cell, since, "script_upload")
    figures.at_most("detected", detected, LOST_S, ALL_BUT_ONE)
    cell.is_well()


@pytest.mark.fault(9, 10)
@rounds(1, 50)
@pytest.mark.problem("acknowledge-required", "no-fault", "protective-stop", "too-early")
def test_only_a_person_acknowledges_a_protective_stop(
    *, cell: LiveCell, finished: Finished, assert_problem: Problem, figures: Figures, count: int
) -> None:
    # On a busy machine, a request may arrive late. It must still arrive before the robot unlocks.
    early_s = 4.9 if figures.whole else 4.0
    detected, failed = [], []
    for number in range(count):
        views = (number + 1) % 2
        location, begin = start_scan_in_motion(cell, views)
        since = log_position(cell)
        cell.controller.protective_stop()
        while cell.client.get(location).json()["state"] != "failed":
            time.sleep(0.002)
        failed_s = time.monotonic()
        stopped_s = wait_for_event(cell, since, lambda event: event["kind"] == "safety")
        detected.append(stops(events_since(cell, since))[0] - stopped_s)
        failed.append(failed_s - stopped_s)
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:protective-stop")
        assert_kept(cell, scan, views)
        assert_followed_plan(cell, begin)
        wait_until(lambda: cell.state()["state"] == "fault")
        assert cell.state()["robot"]["safety_mode"] == "protective_stop"
        # Planning is allowed during a fault and does not clear it.
        assert cell.client.post("/api/viewpoints/plan", json={"views": 2}).status_code == 200
        assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
        assert_problem(cell.client.post("/api/cell/connect"), 409, "acknowledge-required")
        earlier = cell.state()["last_acknowledgement"]
        wait_until(lambda until_s=stopped_s + early_s: time.monotonic() >= until_s)
        answer = cell.client.post("/api/cell/acknowledge")
        assert "try again in" in assert_problem(answer, 409, "too-early")
        assert answer.headers["Retry-After"] in ("1", "2")
        assert cell.state()["last_acknowledgement"] == earlier, "it was refused"
        assert unlock_times(cell, since) == []
        wait_until(lambda until_s=stopped_s + UNLOCK_S + 0.1: time.monotonic() >= until_s)
        answer = cell.client.post("/api/cell/acknowledge")
        assert (answer.status_code, answer.json()["state"]) == (200, "not_ready"), answer.text
        assert answer.json()["last_acknowledgement"]["at"] > ("" if earlier is None else earlier["at"])
        (unlocked_s,) = unlock_times(cell, since)
        assert unlocked_s - stopped_s >= UNLOCK_S
        # The program was ended before, so the old move cannot continue.
        assert cell.controller.state().program_state == "STOPPED"
        assert cell.controller.state().safety_mode == "NORMAL"
        time_to_rest_s(cell, since, stopped_s)
        events = events_since(cell, since)
        assert "play" not in dashboard_commands(events)
        assert not kinds(events, "script_upload")
        assert_problem(cell.client.post("/api/cell/acknowledge"), 409, "no-fault")
    figures.at_most("detected", detected, PROTECTIVE_S, ALL_BUT_ONE)
    figures.at_most("failed", failed, PROTECTIVE_S, ALL_BUT_ONE)
    cell.is_well()


def unlock_times(cell: LiveCell, since: int) -> list[float]:
    """Return the times at which the robot was unlocked, in seconds."""
    commands = [event for event in events_since(cell, since, "dashboard") if "unlock" in event["details"]["command"]]
    return [event["stamp_s"] for event in commands if "releasing" in event["details"]["answer"]]


@pytest.mark.fault(11)
@pytest.mark.parametrize("fault", ["local_mode", "foreign_program"])
@pytest.mark.problem("robot-not-ready")
def test_a_robot_in_other_use_receives_no_program(cell: LiveCell, fault: str) -> None:
    cell.client.post("/api/cell/connect")
    cell.client.post("/api/cell/stop")
    begin = log_position(cell)
    getattr(cell.controller, fault)()
    assert cell.failure()[0] == "robot-not-ready"
    assert cell.state()["state"] == "not_ready"
    assert events_since(cell, begin, "script_upload", "motion_start") == []
    cell.controller.clear()
    if fault == "foreign_program":
        cell.controller.reset()  # a person ends it at the pendant
    cell.is_well()
