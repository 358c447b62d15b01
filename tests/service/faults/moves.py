"""What the controller's log tells of the arm's way: by its own clock and its own word."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.cell.arm.virtual_arm import kinds, motion_commands, stops
from tests.service.conftest import wait_until
from tests.service.live_cell import LiveCell

Events = list[dict[str, Any]]


def now_in(cell: LiveCell) -> int:
    """Number of the next event of the controller's log."""
    return cell.controller.state().events


def seen(cell: LiveCell, since: int, *wanted: str) -> Events:
    """The controller's events of these kinds, of all unless told, from a number on."""
    events = cell.controller.log(since)
    return kinds(events, *wanted) if wanted else events


def first(cell: LiveCell, since: int, true: Callable[[dict[str, Any]], bool]) -> float:
    """When the first such event was noted; waits for it."""
    found: Events = []

    def there() -> bool:
        found[:] = [event for event in cell.controller.log(since) if true(event)]
        return bool(found)

    wait_until(there)
    return found[0]["stamp_s"]


def wait_for_middle(cell: LiveCell, share: float = 0.2, least_s: float = 1.0) -> None:
    """Until so much of a move is done, of one that goes on for so long by a real arm's clock."""

    def there() -> bool:
        state = cell.controller.state()
        if not (state.moving and state.progress >= share):
            return False
        move = kinds(cell.controller.log(max(0, state.events - 20)), "motion_start")[-1]
        return (1 - state.progress) * move["details"]["duration_s"] >= least_s

    wait_until(there)


def wait_for_stop(cell: LiveCell, since: int) -> float:
    """Waits until the controller was told to stop or to end the program; when it was."""
    found: list[float] = []

    def told() -> bool:
        found[:] = stops(cell.controller.log(since))
        return bool(found)

    wait_until(told)
    return found[0]


def still_s(cell: LiveCell, since: int, from_s: float) -> float:
    """How long after `from_s` the arm was at rest; waits until it is. Nothing may have set it in motion since."""
    wait_until(lambda: not cell.moving())
    events = cell.controller.log(since)
    late = [event for event in kinds(events, "motion_start") if event["stamp_s"] > from_s]
    assert not late, f"the arm was set in motion: {late}"
    rests = [event["stamp_s"] for event in kinds(events, "still", "motion_done") if event["stamp_s"] > from_s]
    return max(rests, default=from_s) - from_s


def assert_one_way(cell: LiveCell, since: int, whole: bool = False) -> None:
    """Since then the arm went the way of the last plan from its beginning, each stretch once; to its end if `whole`."""
    plan = cell.client.app.state.context.cell.status.plan
    planned = [q_rad for leg in plan.legs for q_rad in leg.waypoints_rad]
    events = cell.controller.log(since)
    gone = [event["details"]["q_to_rad"] for event in kinds(events, "motion_start")]
    assert len(motion_commands(events)) == len(gone), "a move was sent that the arm did not make"
    assert len(gone) == len(planned) if whole else len(gone) <= len(planned)
    for q_rad, wanted in zip(gone, planned, strict=False):
        assert q_rad == pytest.approx(np.asarray(wanted), abs=1e-9)
