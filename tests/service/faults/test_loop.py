"""The event loop hangs during a move. No client could stop the arm, so the service stops it."""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from service.api.schemas.health import Health
from tests.service.conftest import PATIENCE_S, Serve
from tests.service.faults.figures import Figures, rounds
from tests.service.faults.moves import (
    assert_followed_plan,
    log_position,
    time_to_rest_s,
    wait_for_mid_move,
    wait_for_stop,
)
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

STOPPED_S = 2.0
"""Time limit from the start of the hang until the arm is at rest."""
TIME_FACTOR = 3.0
"""Factor by which the arm moves and brakes faster than a real one."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough that a scan takes longer than the detection of a hang."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=TIME_FACTOR) as shared:
        yield shared


class BlockingHandler:
    """A route handler that blocks the event loop, as a blocking call in a real handler would."""

    def __init__(self) -> None:
        self.since_s = 0.0
        self.begun, self.over = threading.Event(), threading.Event()

    def __call__(self) -> Health:
        """Block the thread of the event loop until `over` is set."""
        self.since_s = time.monotonic()
        self.begun.set()
        assert self.over.wait(PATIENCE_S)
        return Health()


@pytest.mark.fault(27)
@rounds(1, 50)
def test_a_hanging_event_loop_stops_the_arm(
    cell: LiveCell, finished: Finished, figures: Figures, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    noticed, rests = [], []
    for _ in range(count):
        cell.is_well()
        begin, location = log_position(cell), cell.start()
        cell.wait_for_motion(location, views=0)
        wait_for_mid_move(cell)
        since, handler = log_position(cell), BlockingHandler()
        with ThreadPoolExecutor(1) as pool, monkeypatch.context() as patched:
            patched.setattr("service.api.routes.health.Health", handler)
            try:
                answer = pool.submit(cell.client.get, "/healthz")
                assert handler.begun.wait(PATIENCE_S)
                sent_s = wait_for_stop(cell, since)
                rest_s = TIME_FACTOR * time_to_rest_s(cell, since, sent_s)
            finally:
                handler.over.set()
            assert answer.result(PATIENCE_S).status_code == 200, "the loop does not run again"
        noticed.append(sent_s - handler.since_s)
        rests.append(sent_s + rest_s - handler.since_s)
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
        assert "did not answer" in scan["problem"]["detail"]
        assert_followed_plan(cell, begin)
        assert cell.state()["problem"] == "urn:pointchain:stopped"
    figures.at_most("stop on the wire after the start of the hang", noticed, STOPPED_S)
    figures.at_most("arm at rest", rests, STOPPED_S)
    cell.is_well()
