"""The arm is stopped on request: at once, whatever the service is at, and nothing that was seen is lost."""

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
from tests.service.faults.held_database import OtherProcess
from tests.service.faults.moves import assert_one_way, now_in, seen, still_s, wait_for_middle, wait_for_stop
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

WIRE_S = 0.05
"""So soon after the request the controller has been told: 99 of 100 times."""
STILL_S = 0.35
"""So soon after that the arm is at rest."""
ANSWER_S = 2.0
"""So soon whoever asked for it is told, whatever the database does: a client that hears nothing would ask again."""
TIME_FACTOR = 3.0
"""The arm is so many times as fast as a real one, and brakes in as small a part of the time."""


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to be caught in motion; each test leaves it able to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=TIME_FACTOR) as shared:
        yield shared


def assert_stopped(cell: LiveCell, begin: int, scan: dict[str, Any]) -> None:
    """The scan was aborted, its views are kept, and the arm went nowhere else."""
    assert (scan["state"], scan["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    states = [view["state"] for view in scan["progress"]["views"]]
    recorded = states.count("recorded")
    # They are told by number, not in the order taken; at most the one that the arm was on its way to is missing.
    assert states.count("missing") == len(states) - recorded <= 1
    if recorded:
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == recorded
    else:
        assert scan["recording"] is None
    assert_one_way(cell, begin)
    state = cell.state()
    assert (state["state"], state["problem"]) == ("not_ready", "urn:pointchain:stopped")
    # Nobody knows its modes by now, but where it stands: it was seen to come to rest, unless the process that drives it
    # had been too busy to stop it.
    if "stop" not in dashboard_commands(seen(cell, begin)):
        assert state["robot"]["q_rad"] == pytest.approx(list(cell.controller.state().q_rad), abs=2e-3)
    assert state["robot"]["safety_mode"] is None


@pytest.mark.fault(4)
@rounds(2, 100)
def test_in_the_middle_of_a_move(
    cell: LiveCell, finished: Finished, figures: Figures, count: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "service.jobs.runner")
    chance, waits, rests = random.Random(4), [], []
    for number in range(count):
        cell.is_well()
        begin, location = now_in(cell), cell.start()
        cell.wait_for_motion(location, views=(number + 1) % 2)
        wait_for_middle(cell, chance.uniform(0.0, 0.5))
        path = "/api/cell/stop" if number % 2 else f"{location}/cancel"
        since, asked_s = now_in(cell), time.monotonic()
        answer = cell.client.post(path)
        assert answer.status_code == 200, answer.text
        if path == "/api/cell/stop":
            assert answer.json()["problem"] == "urn:pointchain:stopped", "it waits for the arm"
        sent_s = wait_for_stop(cell, since)
        waits.append(sent_s - asked_s)
        rests.append(TIME_FACTOR * still_s(cell, since, sent_s))
        assert_stopped(cell, begin, scan := finished(cell.client, location))
        wait_until(lambda scan=scan, path=path: f"POST {path}" in audited(cell, scan["id"]))
        assert f"scan {scan['id']} begins: live, 8 views" in caplog.messages
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    figures.at_most("arm at rest", rests, STILL_S)
    assert cell.client.post("/api/cell/stop").status_code == 200  # also when nothing runs


def audited(cell: LiveCell, scan_id: str) -> list[str]:
    """What the audit log has of a scan."""
    return [entry.what for entry in read_audit(cell.client.app.state.context.store.folder.root, None, scan_id, None, 9)]


@pytest.mark.fault(5)
@rounds(1, 100)
def test_while_another_process_has_the_database(
    cell: LiveCell, finished: Finished, figures: Figures, count: int
) -> None:
    chance, waits, rests, answers = random.Random(5), [], [], []
    with closing(OtherProcess(cell.client.app.state.context.store.folder.root)) as other, ThreadPoolExecutor(1) as pool:
        for _ in range(count):
            cell.is_well()
            begin, location = now_in(cell), cell.start()
            cell.wait_for_motion(location, views=0)
            wait_for_middle(cell, chance.uniform(0.0, 0.5))
            with other.locking():
                since, asked_s = now_in(cell), time.monotonic()
                answer = pool.submit(cell.client.post, "/api/cell/stop")
                sent_s = wait_for_stop(cell, since)
                waits.append(sent_s - asked_s)
                rests.append(TIME_FACTOR * still_s(cell, since, sent_s))
                assert answer.result().status_code == 200, answer.result().text
                answers.append(time.monotonic() - asked_s)
            assert_stopped(cell, begin, finished(cell.client, location))
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    figures.at_most("answer while the database is held", answers, ANSWER_S)
    figures.at_most("arm at rest", rests, STILL_S)


@pytest.mark.fault(5)
@rounds(1, 100)
def test_while_recognition_is_at_work(cell: LiveCell, finished: Finished, figures: Figures, count: int) -> None:
    """It is frozen when the last view is taken, so that the stop meets it at work; the arm is on its way home."""
    waits, rests, answers = [], [], []
    for _ in range(count):
        cell.is_well()
        wait_until(lambda: cell.client.get("/readyz").status_code == 200)
        recognition = cell.client.recognition_pid
        begin, location = now_in(cell), cell.start(views=2)
        cell.wait_for_motion(location)
        os.kill(recognition, signal.SIGSTOP)
        wait_until(lambda location=location: list(cell.views(location).values()) == ["recorded"] * 2 and cell.moving())
        since, asked_s = now_in(cell), time.monotonic()
        assert cell.client.post("/api/cell/stop").json()["problem"] == "urn:pointchain:stopped"
        answers.append(time.monotonic() - asked_s)
        sent_s = wait_for_stop(cell, since)
        waits.append(sent_s - asked_s)
        rests.append(TIME_FACTOR * still_s(cell, since, sent_s))
        scan = finished(cell.client, location)
        assert [view["state"] for view in scan["progress"]["views"]] == ["recorded"] * 2
        assert_stopped(cell, begin, scan)
    figures.at_most("stop on the wire", waits, WIRE_S, share=0.99)
    figures.at_most("answer while recognition is frozen", answers, GRACE_S)  # it does not wait for its end
    figures.at_most("arm at rest", rests, STILL_S)
