"""Cancel and stop calibrations over HTTP: the arm stops and does not move again. Other requests are refused."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import pytest

from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

RUNS = "/api/calibration/runs"


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that moves slowly enough for a request during a move. Each test leaves it ready."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=5.0) as shared:
        yield shared


def begin(cell: LiveCell) -> str:
    answer = cell.client.post(RUNS, json={"board": None, "poses": 12})
    assert answer.status_code == 202, answer.text
    return answer.headers["Location"]


def test_a_cancel_stops_the_arm_and_keeps_the_images(
    cell: LiveCell, finished: Finished, assert_problem: Problem
) -> None:
    location = begin(cell)
    assert cell.state()["state"] == "busy"
    for path, body in (
        ("/api/scans", SCAN),
        (RUNS, {}),
        ("/api/calibration/verify", None),
        ("/api/cell/release", None),
    ):
        answer = cell.client.post(path, json=body)
        assert "calibration" in assert_problem(answer, 409, "cell-busy")
        assert answer.headers["Location"] == location
    assert_problem(cell.client.post(f"{location}/activate"), 409, "cell-busy")
    cell.wait_for_motion(location)
    before = time.monotonic()
    assert cell.client.post(f"{location}/cancel").status_code == 200
    run = finished(cell.client, location)
    assert (run["state"], run["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    views = run["progress"]["views"]
    assert views[-1]["state"] == "missing" or [view["state"] for view in views].count("missing") == 1, (
        "only the view that was being captured may be missing"
    )
    for view in views:
        assert (view["image"] is None) == (view["state"] == "missing")
        if view["image"] is not None:
            assert cell.client.get(view["image"]).content.startswith(b"\x89PNG")
    wait_until(lambda: not cell.moving())
    braking = cell.events("braking", after_s=before)
    assert braking, "the arm was not stopped"
    assert cell.events("motion_start", after_s=braking[0]["stamp_s"]) == []
    assert (cell.state()["state"], cell.state()["problem"]) == ("not_ready", "urn:pointchain:stopped")
    assert_problem(cell.client.post(f"{location}/activate"), 409, "not-activatable")
    assert cell.client.post(f"{location}/cancel").json()["state"] == "aborted"
    assert cell.client.get("/api/calibration").json()["active_run"] is None
    cell.is_well()


def test_a_stop_aborts_a_calibration_and_the_next_scan_succeeds(
    cell: LiveCell, finished: Finished, assert_problem: Problem
) -> None:
    location = begin(cell)
    cell.wait_for_motion(location, views=0)
    assert cell.client.post("/api/cell/stop").status_code == 200
    run = finished(cell.client, location)
    assert (run["state"], run["problem"]["type"]) == ("aborted", "urn:pointchain:aborted")
    assert run["result"] is None
    scan = cell.start(views=4)
    answer = cell.client.post(RUNS, json={})
    assert "scan" in assert_problem(answer, 409, "cell-busy")
    assert answer.headers["Location"] == scan
    assert finished(cell.client, scan)["summary"]["chains"] == 1
