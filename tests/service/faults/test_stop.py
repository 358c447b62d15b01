"""A stop request stops the arm at once, whatever the service does, and keeps all recorded views."""

import logging
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

import httpx2
import pytest

from service.jobs.manager import GRACE_S
from service.security.audit.reader import read_audit
from tests.cell.arm.virtual_arm import dashboard_commands
from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import Figures, rounds
from tests.service.faults.locked_database import OtherProcess
from tests.service.faults.moves import (
    assert_followed_plan,
    events_since,
    log_position,
    time_to_rest_s,
    wait_for_mid_move,
    wait_for_stop,
)
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

WIRE_S = 0.05
"""Time limit from the request until the controller receives the stop, for 99 of 100 stops."""
STILL_S = 0.35
"""Time limit from then until the arm is at rest."""
ANSWER_S = 2.0
"""Time limit of the answer while the database is locked. A client without an answer would repeat the request."""
TIME_FACTOR = 3.0
"""Factor by which the arm moves and brakes faster than a real one."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to catch in motion. Each test leaves it ready to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=TIME_FACTOR) as shared:
        yield shared


def assert_stopped(cell: LiveCell, begin: int, scan: dict[str, Any]) -> None:
    """Assert that the scan was aborted, its views are kept, and the arm made no other move."""
    assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    states = [view["state"] for view in scan["progress"]["views"]]
    recorded = states.count("recorded")
    # Views are listed by number. At most one is missing: the view that the arm was moving to.
    assert states.count("missing") == len(states) - recorded <= 1
    if recorded:
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == recorded
    else:
        assert scan["recording"] is None
    assert_followed_plan(cell, begin)
    state = cell.state()
    assert (state["state"], state["problem"]) == ("not_ready", "urn:pointchain:stopped")
    # The modes are unknown after a stop. The position is known: the service saw the arm come to rest, unless the
    # driver's process was too busy and the stop went through the dashboard.
    if "stop" not in dashboard_commands(events_since(cell, begin)):
        assert state["robot"]["q_rad"] == pytest.approx(list(cell.controller.state().q_rad), abs=2e-3)
    assert state["robot"]["safety_mode"] is None


@pytest.mark.fault(4)
@rounds(2, 100)
def test_stop_during_a_move(
    cell: LiveCell, finished: Finished, figures: Figures, count: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service.jobs.runner")
    rng, waits, rests = random.Random(4), [], []
    for number in range(count):
        cell.is_well()
        begin, location = log_position(cell), cell.start()
        cell.wait_for_motion(location, views=(number + 1) % 2)
        wait_for_mid_move(cell, rng.uniform(0.0, 0.5))
        path = "/api/cell/stop" if number % 2 else f"{location}/cancel"
        since, requested_s = log_position(cell), time.monotonic()
        answer = cell.client.post(path)
        assert answer.status_code == 200, answer.text
        if path == "/api/cell/stop":
            assert answer.json()["problem"] == "urn:pointchain:stopped", "the stop did not wait for the arm"
        sent_s = wait_for_stop(cell, since)
        waits.append(sent_s - requested_s)
        rests.append(TIME_FACTOR * time_to_rest_s(cell, since, sent_s))
        assert_stopped(cell, begin, scan := finished(cell.client, location))
        wait_until(lambda scan=scan, path=path: f"POST {path}" in audit_entries(cell, scan["id"]))
        assert f"scan {scan['id']} begins: live" in caplog.messages
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    figures.at_most("arm at rest", rests, STILL_S)
    assert cell.client.post("/api/cell/stop").status_code == 200  # also without a scan


def audit_entries(cell: LiveCell, scan_id: str) -> list[str]:
    """Return the entries of a scan in the audit log."""
    return [entry.what for entry in read_audit(cell.client.app.state.context.store.folder.root, None, scan_id, None, 9)]


@pytest.mark.fault(5)
@rounds(1, 100)
def test_stop_while_another_process_locks_the_database(
    cell: LiveCell, finished: Finished, figures: Figures, count: int
) -> None:
    rng, waits, rests, answers = random.Random(5), [], [], []
    with closing(OtherProcess(cell.client.app.state.context.store.folder.root)) as other, ThreadPoolExecutor(1) as pool:
        for _ in range(count):
            cell.is_well()
            begin, location = log_position(cell), cell.start()
            cell.wait_for_motion(location, views=0)
            wait_for_mid_move(cell, rng.uniform(0.0, 0.5))
            with other.locking():
                since, requested_s = log_position(cell), time.monotonic()
                answer = pool.submit(cell.client.post, "/api/cell/stop")
                sent_s = wait_for_stop(cell, since)
                waits.append(sent_s - requested_s)
                rests.append(TIME_FACTOR * time_to_rest_s(cell, since, sent_s))
                assert answer.result().status_code == 200, answer.result().text
                answers.append(time.monotonic() - requested_s)
            assert_stopped(cell, begin, finished(cell.client, location))
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    figures.at_most("answer while the database is locked", answers, ANSWER_S)
    figures.at_most("arm at rest", rests, STILL_S)


@pytest.mark.fault(5)
@rounds(1, 100)
def test_stop_during_recognition(cell: LiveCell, finished: Finished, figures: Figures, count: int) -> None:
    """Recognition is frozen before the last view, so that the stop arrives during it, while the arm moves home."""
    waits, rests, answers = [], [], []
    for _ in range(count):
        cell.is_well()
        wait_until(lambda: cell.client.get("/readyz").status_code == 200)
        recognition = cell.client.recognition_pid
        begin, location = log_position(cell), cell.start(views=2)
        cell.wait_for_motion(location)
        os.kill(recognition, signal.SIGSTOP)
        wait_until(lambda location=location: list(cell.views(location).values()) == ["recorded"] * 2 and cell.moving())
        since, requested_s = log_position(cell), time.monotonic()
        assert cell.client.post("/api/cell/stop").json()["problem"] == "urn:pointchain:stopped"
        answers.append(time.monotonic() - requested_s)
        sent_s = wait_for_stop(cell, since)
        waits.append(sent_s - requested_s)
        rests.append(TIME_FACTOR * time_to_rest_s(cell, since, sent_s))
        scan = finished(cell.client, location)
        assert [view["state"] for view in scan["progress"]["views"]] == ["recorded"] * 2
        assert_stopped(cell, begin, scan)
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    # The answer does not wait for the end of recognition.
    figures.at_most("answer while recognition is frozen", answers, GRACE_S)
    figures.at_most("arm at rest", rests, STILL_S)
