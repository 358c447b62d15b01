"""More clients than the limit follow events, and many of them never read. Other requests are not affected."""

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
from tests.service.faults.moves import assert_followed_plan, log_position, wait_for_mid_move, wait_for_stop
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

FOLLOWERS = 200
"""Number of clients that request event streams. Every other accepted client never reads."""
STOP_S = 0.1
"""Time limit from the request until the controller receives the stop, and until the answer; for 99 of 100 stops."""
EVENTS, EVENT_BYTES = 1000, 8000
"""Number and size of the events that are sent to slow clients."""
GROWTH_BYTES = 64 << 20
"""Limit of the memory that these events may use. Buffering all of them for 16 clients would need twice as much."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to catch in motion."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=3.0) as shared:
        yield shared


@pytest.mark.fault(25)
@rounds(1, 100)
def test_200_event_streams_do_not_delay_a_stop(
    cell: LiveCell, finished: Finished, figures: Figures, count: int
) -> None:
    rng, waits, answers = random.Random(25), [], []
    streams, port = cell.client.app.state.context.streams, cell.client.base_url.port
    assert port is not None
    limit = LimitsConfig().event_streams
    mix = [LoadRequest("cell", "/api/cell"), LoadRequest("scans", "/api/scans?limit=20")]
    cell.is_well()
    load = Load(port, connections=8, requests=mix, pause_s=0.0 if figures.whole else 0.1, streams=FOLLOWERS)
    with run_load(load) as counts:
        wait_until(lambda: streams.open == limit)
        for _ in range(count):
            begin, location = log_position(cell), cell.start()
            cell.wait_for_motion(location, views=0)
            wait_for_mid_move(cell, rng.uniform(0.0, 0.5))
            assert streams.open <= limit
            since, requested_s = log_position(cell), time.monotonic()
            assert cell.client.post("/api/cell/stop").status_code == 200
            answers.append(time.monotonic() - requested_s)
            waits.append(wait_for_stop(cell, since) - requested_s)
            assert finished(cell.client, location)["state"] == "aborted"
            assert_followed_plan(cell, begin)
        publish_many_events(cell)
        wait_until(lambda: not stream_is_accepted(cell))  # a dropped slow client leaves its stream free for a moment
    assert counts["wrong"] == []
    assert counts["let_in"] >= limit
    assert counts["refused"] >= FOLLOWERS - limit
    assert counts["news_bytes"] > EVENT_BYTES, "the reading clients received no events"
    wait_until(lambda: streams.open == 0)
    cell.is_well()
    figures.at_most("stop on the wire", waits, STOP_S, share=0.99)
    figures.at_most("stop to its answer", answers, STOP_S, share=0.99)


def stream_is_accepted(cell: LiveCell) -> bool:
    """Return whether the service accepts another event stream."""
    with cell.client.stream("GET", "/api/events") as answer:
        if answer.status_code == 503:
            assert json.loads(answer.read())["type"] == "urn:pointchain:too-many-streams"
        return answer.status_code == 200


def publish_many_events(cell: LiveCell) -> None:
    """Publish more events than clients read at once, and assert that their memory is limited."""
    hub, before = cell.client.app.state.context.store.events.hub, rss_bytes(os.getpid())
    for number in range(EVENTS):
        hub.publish("scan", ScanEvent(number, "scan", "", "progress", {"stage": "x" * EVENT_BYTES, "fraction": 0.5}))
        if number % 20 == 0:
            assert cell.client.get("/healthz").status_code == 200  # the event loop has sent these events
    assert rss_bytes(os.getpid()) - before < GROWTH_BYTES
