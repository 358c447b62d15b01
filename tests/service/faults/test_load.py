"""More clients than there is room for, of which many take nothing of what they are sent: the rest is as it was."""

import json
import os
import random
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import pytest

from service.benchmark.load_generator import Load, LoadRequest, run_load
from service.config.sections import LimitsConfig
from service.storage.event_log import ScanEvent
from tests.processes import rss_bytes
from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import Figures, rounds
from tests.service.faults.moves import assert_one_way, now_in, wait_for_middle, wait_for_stop
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

FOLLOWERS = 200
"""So many clients want to follow events, and every other one that may never reads."""
STOP_S = 0.1
"""So soon after the request the controller has been told, and the answer is there: 99 of 100 times."""
NEWS, NEWS_BYTES = 1000, 8000
"""What the slow ones are sent, ..."""
GROWTH_BYTES = 64 << 20
"""... and what of that the service may keep: 8 MB for each of 16 is twice as much."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to be caught in motion."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=3.0) as shared:
        yield shared


@pytest.mark.fault(25)
@rounds(1, 100)
def test_two_hundred_followers_delay_no_stop(cell: LiveCell, finished: Finished, figures: Figures, count: int) -> None:
    chance, waits, answers = random.Random(25), [], []
    streams, port = cell.client.app.state.context.streams, cell.client.base_url.port
    assert port is not None
    room = LimitsConfig().event_streams
    mix = [LoadRequest("cell", "/api/cell"), LoadRequest("scans", "/api/scans?limit=20")]
    cell.is_well()
    load = Load(port, connections=8, requests=mix, pause_s=0.0 if figures.whole else 0.1, streams=FOLLOWERS)
    with run_load(load) as met:
        wait_until(lambda: streams.open == room)
        for _ in range(count):
            begin, location = now_in(cell), cell.start()
            cell.wait_for_motion(location, views=0)
            wait_for_middle(cell, chance.uniform(0.0, 0.5))
            assert streams.open <= room
            since, requested_s = now_in(cell), time.monotonic()
            assert cell.client.post("/api/cell/stop").status_code == 200
            answers.append(time.monotonic() - requested_s)
            waits.append(wait_for_stop(cell, since) - requested_s)
            assert finished(cell.client, location)["state"] == "aborted"
            assert_one_way(cell, begin)
        tell_much(cell)
        wait_until(lambda: not let_in(cell))  # the place of one that took nothing for too long is free for a moment
    assert met["wrong"] == []
    assert met["let_in"] >= room
    assert met["refused"] >= FOLLOWERS - room
    assert met["news_bytes"] > NEWS_BYTES, "those who read were told"
    wait_until(lambda: streams.open == 0)
    cell.is_well()
    figures.at_most("stop on the wire", waits, STOP_S, share=0.99)
    figures.at_most("stop to its answer", answers, STOP_S, share=0.99)


def let_in(cell: LiveCell) -> bool:
    """Whether there is room for one more who follows events."""
    with cell.client.stream("GET", "/api/events") as answer:
        if answer.status_code == 503:
            assert json.loads(answer.read())["type"] == "urn:pointchain:too-many-streams"
        return answer.status_code == 200


def tell_much(cell: LiveCell) -> None:
    """More than anybody takes at once: what those who do not read it cost is bounded."""
    hub, before = cell.client.app.state.context.store.events.hub, rss_bytes(os.getpid())
    for number in range(NEWS):
        hub.publish("scan", ScanEvent(number, "scan", "", "progress", {"stage": "x" * NEWS_BYTES, "fraction": 0.5}))
        if number % 20 == 0:
            assert cell.client.get("/healthz").status_code == 200  # the loop has brought these on their way
    assert rss_bytes(os.getpid()) - before < GROWTH_BYTES
