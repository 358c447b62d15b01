"""Stopping and cancelling live scans over HTTP: the arm stops, stays, and what was seen is kept."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from service.schemas import ACTIVE_STATES
from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx.Client, str], dict[str, Any]]


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to be caught in motion; each test leaves it able to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=5.0) as shared:
        yield shared


def test_cancel_stops_the_arm_and_keeps_the_views(cell: LiveCell) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    before = time.monotonic()
    answer = cell.client.post(f"{location}/cancel")
    assert answer.json()["state"] == "aborted", answer.text
    assert answer.json()["problem"]["type"] == "urn:pointchain:aborted"
    states = list(cell.views(location).values())
    assert states[-1] == "missing", "the view under way"
    taken = states.count("recorded")
    assert taken == len(states) - 1
    assert cell.client.get(f"/api/recordings/{answer.json()['recording']}").json()["views"] == taken
    wait_until(lambda: not cell.moving())
    braking = cell.events("braking", after_s=before)
    assert braking, "the arm was not stopped"
    assert cell.events("motion_start", after_s=braking[0]["stamp_s"]) == []
    state = cell.state()
    assert (state["state"], state["problem"]) == ("not_ready", "urn:pointchain:stopped")
    # Where it stands is where it was last seen; nobody knows its modes by now.
    assert state["robot"]["q_rad"] == pytest.approx(list(cell.controller.state().q_rad), abs=2e-3)
    assert state["robot"]["safety_mode"] is None
    cell.is_well()


def test_stop_aborts_the_scan_and_works_when_nothing_runs(cell: LiveCell, finished: Finished) -> None:
    assert cell.client.post("/api/cell/stop").status_code == 200
    location = cell.start()
    cell.wait_for_motion(location, views=0)
    assert cell.client.post("/api/cell/stop").status_code == 200
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    assert cell.state()["state"] == "not_ready"
    assert cell.client.post("/api/cell/stop").status_code == 200
    cell.is_well()


def test_a_scan_can_be_stopped_while_recognition_is_behind(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    (recognition,) = [child.pid for child in multiprocessing.active_children() if child.name == "recognition"]
    assert recognition is not None
    os.kill(recognition, signal.SIGSTOP)  # it gets no further; the arm does
    wait_until(lambda: list(cell.views(location).values()) == ["recorded"] * 8)
    assert cell.client.get(location).json()["state"] in ACTIVE_STATES
    assert cell.client.post("/api/cell/stop").status_code == 200
    stopped = time.monotonic()
    scan = finished(cell.client, location)
    assert scan["state"] == "aborted", scan
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 8
    assert cell.events("motion_start", after_s=stopped) == []
    cell.is_well()
