"""Viewpoints out of reach are reported by number and reason before the arm moves."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tests.service.conftest import Serve
from tests.service.faults.moves import assert_followed_plan, events_since, log_position
from tests.service.following import read_events
from tests.service.live_cell import SCAN, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

FAR_M = (0.55, 0.85)
"""A workspace whose far side is out of the arm's reach."""


@pytest.mark.fault(18)
@pytest.mark.problem("viewpoints-unreachable")
def test_unreachable_viewpoints_are_refused_or_left_missing(
    serve: Serve, tmp_path: Path, assert_problem: Problem, finished: Finished
) -> None:
    with live_cell(serve, tmp_path / "data", workspace={"x_m": FAR_M}) as cell:
        # With three viewpoints, all are needed.
        three = SCAN | {"views": 3}
        checked = cell.client.post("/api/scans", json=three | {"validate_only": True})
        detail = assert_problem(checked, 422, "viewpoints-unreachable")
        assert "0: out of the arm's reach" in detail
        assert "1: " not in detail
        assert cell.client.get("/api/scans").json() == {"scans": [], "next": None}
        assert cell.failure(views=3) == ("viewpoints-unreachable", detail)
        assert events_since(cell, 0, "motion_start") == []

        plan = cell.client.post("/api/viewpoints/plan", json={}).json()
        missing = {point["index"]: point["reason"] for point in plan["viewpoints"] if point["reason"] is not None}
        assert len(plan["viewpoints"]) == 8
        assert set(missing.values()) == {"out of the arm's reach"}
        assert 4 <= plan["reachable"] == 8 - len(missing) < 8

        begin, location = log_position(cell), cell.start()
        scan = finished(cell.client, location)
        assert scan["state"] == "partial", scan
        views = {view["index"]: view for view in scan["progress"]["views"]}
        assert {index: views[index]["reason"] for index in missing} == missing
        assert {view["state"] for index, view in views.items() if index not in missing} == {"recorded"}
        assert len(views) == 8
        findings = cell.client.get(scan["links"]["model"]).json()["quality"]["findings"]
        notes = {found["view"]: found["message"] for found in findings if found["code"] == "view-missing"}
        assert notes.keys() == missing.keys()
        assert all(f"view {index} is missing: {missing[index]}" in message for index, message in notes.items())
        # The missing views were reported before the first move.
        events = [
            event.data["data"] for event in read_events(cell.client, f"{location}/events", 0) if event.kind == "view"
        ]
        assert [event["index"] for event in events[: len(missing)]] == sorted(missing)
        assert events[len(missing)]["state"] == "moving"
        assert_followed_plan(cell, begin)
