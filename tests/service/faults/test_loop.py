"""The event loop hangs while the arm moves: nobody could stop it any more, so the service does."""

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
from tests.service.faults.moves import assert_one_way, now_in, still_s, wait_for_middle, wait_for_stop
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

STOPPED_S = 2.0
"""So soon after the loop began to hang, the arm is at rest."""
TIME_FACTOR = 3.0
"""The arm is so many times as fast as a real one, and brakes in as small a part of the time."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Slow enough that a scan takes longer than a hanging loop goes unnoticed."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=TIME_FACTOR) as shared:
        yield shared


class Hanging:
    """An address whose answer holds the event loop: what a call that blocks would do, were there one by mistake."""

    def __init__(self) -> None:
        self.since_s = 0.0
        self.begun, self.over = threading.Event(), threading.Event()

    def __call__(self) -> Health:
        """In the event loop's thread."""
        self.since_s = time.monotonic()
        self.begun.set()
        assert self.over.wait(PATIENCE_S)
        return Health()


@pytest.mark.fault(27)
@rounds(1, 50)
def test_a_hanging_loop_stops_the_arm(
    cell: LiveCell, finished: Finished, figures: Figures, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    noticed, rests = [], []
    for _ in range(count):
        cell.is_well()
        begin, location = now_in(cell), cell.start()
        cell.wait_for_motion(location, views=0)
        wait_for_middle(cell)
        since, hanging = now_in(cell), Hanging()
        with ThreadPoolExecutor(1) as pool, monkeypatch.context() as patched:
            patched.setattr("service.api.routes.health.Health", hanging)
            try:
                answer = pool.submit(cell.client.get, "/healthz")
                assert hanging.begun.wait(PATIENCE_S)
                sent_s = wait_for_stop(cell, since)
                rest_s = TIME_FACTOR * still_s(cell, since, sent_s)
            finally:
                hanging.over.set()
            assert answer.result(PATIENCE_S).status_code == 200, "the loop turns again"
        noticed.append(sent_s - hanging.since_s)
        rests.append(sent_s + rest_s - hanging.since_s)
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
        assert "did not answer" in scan["problem"]["detail"]
        assert_one_way(cell, begin)
        assert cell.state()["problem"] == "urn:pointchain:stopped"
    figures.at_most("stop on the wire behind the beginning of the hang", noticed, STOPPED_S)
    figures.at_most("arm at rest", rests, STOPPED_S)
    cell.is_well()
