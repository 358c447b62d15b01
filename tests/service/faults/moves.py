"""Helpers that check the arm's motion in the controller's log, by the controller's clock."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.cell.arm.virtual_arm import kinds, motion_commands, stops
from tests.service.conftest import wait_until
from tests.service.live_cell import LiveCell

Events = list[dict[str, Any]]


def log_position(cell: LiveCell) -> int:
    """Return the number of the next event in the controller's log."""
    return cell.controller.state().events


def events_since(cell: LiveCell, since: int, *names: str) -> Events:
    """Return the controller's events from number `since` on, of the given kinds or else of all."""
    events = cell.controller.log(since)
    return kinds(events, *names) if names else events


def wait_for_event(cell: LiveCell, since: int, matches: Callable[[dict[str, Any]], bool]) -> float:
    """Wait for the first matching event and return its time, in seconds."""
    found: Events = []

    def found_one() -> bool:
        found[:] = [event for event in cell.controller.log(since) if matches(event)]
        return bool(found)

    wait_until(found_one)
    return found[0]["stamp_s"]


def wait_for_mid_move(cell: LiveCell, share: float = 0.2, min_left_s: float = 1.0) -> None:
    """Wait until a `share` of a move is done and at least `min_left_s` of a real arm's time is left."""

    def reached() -> bool:
        state = cell.controller.state()
        if not (state.moving and state.progress >= share):
            return False
        move = kinds(cell.controller.log(max(0, state.events - 20)), "motion_start")[-1]
        return (1 - state.progress) * move["details"]["duration_s"] >= min_left_s

    wait_until(reached)


def wait_for_stop(cell: LiveCell, since: int) -> float:
    """Wait until the controller receives a stop or the end of the program. Return the time, in seconds."""
    found: list[float] = []

    def stop_received() -> bool:
        found[:] = stops(cell.controller.log(since))
        return bool(found)

    wait_until(stop_received)
    return found[0]


def time_to_rest_s(cell: LiveCell, since: int, from_s: float) -> float:
    """Wait until the arm is at rest and return the seconds since `from_s`. No motion may begin after it."""
    wait_until(lambda: not cell.moving())
    events = cell.controller.log(since)
    late = [event for event in kinds(events, "motion_start") if event["stamp_s"] > from_s]
    assert not late, f"the arm began to move again: {late}"
    rests = [event["stamp_s"] for event in kinds(events, "still", "motion_done") if event["stamp_s"] > from_s]
    return max(rests, default=from_s) - from_s


def assert_followed_plan(cell: LiveCell, since: int, whole: bool = False) -> None:
    """Assert that the arm followed the last plan from its start, each segment once; to its end if `whole`.

    A scan that was cancelled before it had a plan has moved nothing.
    """
    plan = cell.client.app.state.context.cell.status.plan
    planned = [] if plan is None else [q_rad for leg in plan.legs for q_rad in leg.waypoints_rad]
    events = cell.controller.log(since)
    visited = [event["details"]["q_to_rad"] for event in kinds(events, "motion_start")]
    assert len(motion_commands(events)) == len(visited), "the arm did not make every move that was sent"
    assert len(visited) == len(planned) if whole else len(visited) <= len(planned)
    for q_rad, planned_rad in zip(visited, planned, strict=False):
        assert q_rad == pytest.approx(np.asarray(planned_rad), abs=1e-9)
