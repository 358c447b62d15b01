"""Live scans over HTTP: the real ur_rtde and depthai in child processes, against the virtual controller."""

import hashlib
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.storage.store import Store
from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that the tests of this module share. Each test leaves it without a fault."""
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


def test_a_live_scan_gives_the_true_model_and_a_replay_gives_the_same(
    cell: LiveCell, finished: Finished, tmp_path: Path
) -> None:
    location = cell.start(all_grasps=True)
    scan = finished(cell.client, location)
    assert scan["state"] == "succeeded", scan
    assert scan["problem"] is None
    assert scan["all_grasps"] is True
    assert (scan["summary"]["verdict"], scan["summary"]["doubts"]) == ("accept", [])
    assert scan["progress"]["fraction"] == 1.0
    assert [view["state"] for view in scan["progress"]["views"]] == ["recorded"] * 8
    model = cell.client.get(scan["links"]["model"]).json()
    # The default scene is a figure of eight: one string, one crossing, 0.4 m long.
    assert len(model["chains"]) == 1
    assert len(model["crossings"]) == 1
    assert model["chains"][0]["length_m"] == pytest.approx(0.4, abs=0.006)
    assert model["crossings"][0]["gap_m"] == pytest.approx(0.0084, abs=0.001)

    recording = cell.client.get(f"/api/recordings/{scan['recording']}").json()
    assert recording["views"] == 8
    assert recording["created_at"] == scan["created_at"]  # so that a person recognises its scan
    assert recording["missing"] == []
    assert scan["calibration_sha256"] == recording["provenance"]["calibration_sha256"] is not None
    content = cell.client.get(scan["links"]["recording"]).content
    taken = cell.client.get(scan["links"]["views"]).json()["views"]
    assert [view["index"] for view in taken] == list(range(8))
    assert cell.client.get(taken[7]["image"]).content.startswith(b"\x89PNG")
    store: Store = cell.client.app.state.context.store
    row, views = store.scans.get(scan["id"]), store.scans.views([scan["id"]])
    for view in views:
        assert view.offset_bytes is not None
        assert view.size_bytes is not None
        piece = content[view.offset_bytes : view.offset_bytes + view.size_bytes]
        assert hashlib.sha256(piece).hexdigest() == view.sha256
    assert row is not None
    assert row.inputs is not None
    assert row.request.all_grasps
    assert row.inputs["views"] == [{"view": view.view, "sha256": view.sha256} for view in views]

    answer = cell.client.post(scan["links"]["reprocess"])
    again = finished(cell.client, answer.headers["Location"])
    assert again["all_grasps"] is True
    replayed = cell.client.get(again["links"]["model"]).json()
    assert model["provenance"] == {
        "release": version("pointchain"),
        "scan": scan["id"],
        "captured_at": model["provenance"]["captured_at"],
        "recording_sha256": hashlib.sha256(content).hexdigest(),
        "calibration_sha256": scan["calibration_sha256"],
        "simulated": True,
        "intensity_views": 8,
    }
    assert scan["started_at"] < model["provenance"]["captured_at"] < scan["ended_at"]
    assert (scan["simulated"], again["simulated"], recording["simulated"]) == (True, True, True)
    assert cell.client.get("/api/cell").json()["simulated"] is True
    assert replayed["provenance"].pop("scan") == again["id"]
    del model["provenance"]["scan"]
    for each in (model, replayed):
        each.pop("timing_s")
    assert replayed == model


def test_a_quick_scan_of_a_clear_table_takes_four_views(cell: LiveCell, finished: Finished) -> None:
    scan = finished(cell.client, cell.start(views="auto"))
    assert (scan["state"], scan["views"]) == ("succeeded", "auto")
    assert scan["progress"]["fraction"] == 1.0
    states = {view["index"]: view["state"] for view in scan["progress"]["views"]}
    assert len(states) == 4
    assert set(states.values()) == {"recorded"}
    assert set(states) == {1, 3, 5, 7}
    assert scan["summary"]["verdict"] == "accept"
    model = cell.client.get(scan["links"]["model"]).json()
    assert [len(model["chains"]), len(model["crossings"])] == [1, 1]
    assert {view["index"] for view in model["quality"]["views"]} == set(states)
    assert "more-views-needed" not in {found["code"] for found in model["quality"]["findings"]}
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 4
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["missing"] == []


def test_a_scan_says_how_long_its_parts_took(cell: LiveCell, finished: Finished) -> None:
    wait_until(lambda: cell.state()["state"] != "busy")
    cell.is_well()
    begin = time.monotonic()
    accepted = cell.client.post("/api/scans", json=SCAN).json()
    assert (accepted["state"], accepted["final"]) == ("connecting", False)
    assert (accepted["progress"]["elapsed_s"], accepted["progress"]["remaining_s"]) == (None, None)
    unknown = dict.fromkeys(("wait", "connect", "plan", "expected_to_model", "expected_to_home", "to_model", "to_home"))
    assert accepted["timing_s"] == unknown | {"views": [], "recognition": {}}
    location = accepted["links"]["self"]
    cell.wait_for_motion(location)
    progress = cell.client.get(location).json()["progress"]
    assert progress["elapsed_s"] > 0
    assert progress["remaining_s"] is not None
    scan = finished(cell.client, location)
    assert (scan["progress"]["elapsed_s"], scan["progress"]["remaining_s"]) == (None, None)
    wait_until(lambda: cell.client.get(location).json()["timing_s"]["to_home"] is not None)
    whole_s = time.monotonic() - begin
    timing = cell.client.get(location).json()["timing_s"]
    assert [view["index"] for view in timing["views"]] == list(range(8))
    assert all(view["move"] > 0 and view["exposure"] > 0 and view["settle"] == 0 for view in timing["views"])
    model = cell.client.get(scan["links"]["model"]).json()
    rounded = {stage: pytest.approx(seconds, abs=0.001) for stage, seconds in model["timing_s"].items()}
    assert timing["recognition"] == rounded
    assert timing["expected_to_model"] > 0
    assert timing["expected_to_home"] > 0
    # The parts come one after the other, and the arm goes home last.
    parts_s = sum(timing[part] for part in ("wait", "connect", "plan"))
    parts_s += sum(view["move"] + view["settle"] + view["exposure"] for view in timing["views"])
    assert 0 < parts_s < timing["to_model"] < timing["to_home"] < whole_s


def test_a_valid_request_for_a_live_scan_shows_its_viewpoints(cell: LiveCell, assert_problem: Problem) -> None:
    wait_until(lambda: cell.state()["state"] != "busy")
    scans = cell.client.get("/api/scans").json()
    request = SCAN | {"views": 4, "validate_only": True}
    answer = cell.client.post("/api/scans", json=request, headers={"Idempotency-Key": "only checked"})
    assert answer.status_code == 200, answer.text
    assert answer.json() == {
        "valid": True,
        "mode": "live",
        "recording": None,
        "method": "graph",
        "string_radius_m": 0.0042,
        "all_grasps": False,
        "viewpoints": {"planned": 4, "reachable": 4, "unreachable": [], "warning": None},
    }
    assert cell.client.get("/api/scans").json() == scans
    # the key is free
    started = cell.client.post("/api/scans", json=SCAN, headers={"Idempotency-Key": "only checked"})
    assert started.status_code == 202
    assert_problem(cell.client.post("/api/scans", json=request), 409, "cell-busy")
    assert cell.client.post(f"{started.headers['Location']}/cancel").status_code == 200


def test_the_cell_reports_its_devices(cell: LiveCell) -> None:
    wait_until(lambda: cell.state()["state"] != "busy")  # the arm is home
    cell.is_well()
    assert cell.client.post("/api/viewpoints/plan").status_code == 200
    state = cell.state()
    assert (state["state"], state["reason"], state["problem"]) == ("ready", None, None)
    assert state["robot"]["model"] == "ur5e"
    assert (state["robot"]["robot_mode"], state["robot"]["safety_mode"]) == ("running", "normal")
    assert len(state["robot"]["q_rad"]) == 6
    assert state["camera"]["width"] == 640
    assert state["calibration"]["sha256"]
    assert state["viewpoints"] == {"planned": 8, "reachable": 8, "unreachable": [], "warning": None}


def test_a_request_during_a_scan_is_refused_with_that_scan(
    cell: LiveCell, assert_problem: Problem, finished: Finished
) -> None:
    location = cell.start()
    assert cell.state()["state"] == "busy"  # from the acceptance, even if the arm does not move yet
    for path, body in (("/api/scans", SCAN), ("/api/cell/release", None)):
        answer = cell.client.post(path, json=body)
        assert_problem(answer, 409, "cell-busy")
        assert answer.headers["Location"] == location
    assert finished(cell.client, location)["state"] == "succeeded"


def test_a_recorded_view_is_available_while_the_arm_moves(cell: LiveCell) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    first = cell.client.get(f"{location}/views").json()["views"][0]
    picture = cell.client.get(first["image"])
    scan = cell.client.get(location).json()
    assert (scan["state"], scan["recording"]) == ("scanning", None)
    assert picture.content.startswith(b"\x89PNG")
    assert first["width"] == 640
    assert cell.client.post(f"{location}/cancel").status_code == 200
    wait_until(lambda: cell.client.get(location).json()["state"] == "aborted")
    # The recording is complete now, and the view is unchanged.
    assert cell.client.get(f"{location}/views").json()["views"][0] == first
    again = cell.client.get(first["image"], headers={"If-None-Match": picture.headers["ETag"]})
    assert again.status_code == 304
    cell.is_well()


def test_a_released_arm_accepts_other_programs_until_the_next_scan(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    assert finished(cell.client, location)["state"] == "succeeded"
    if (state := cell.state())["state"] == "busy":
        assert "returns home" in state["reason"]
    # A release during the move home waits for the end of the move.
    begin = time.monotonic()
    answer = cell.client.post("/api/cell/release")
    assert (answer.status_code, answer.json()["state"]) == (200, "not_ready"), answer.text
    assert answer.json()["problem"] == "urn:pointchain:released"
    assert answer.json()["robot"]["at_home"] is True
    assert not cell.moving()
    assert cell.controller.state().program_state == "STOPPED"
    assert cell.events("braking", after_s=begin) == []
    assert cell.client.post("/api/cell/release").status_code == 200
    assert finished(cell.client, cell.start())["state"] == "succeeded"


def test_an_arm_that_is_released_after_a_stop_is_not_reported_as_home(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    assert cell.client.post("/api/cell/stop").json()["robot"]["at_home"] is False
    finished(cell.client, location)
    released = cell.client.post("/api/cell/release").json()
    assert (released["problem"], released["robot"]["at_home"]) == ("urn:pointchain:released", False)
    assert "not its home posture" in released["reason"]
    assert finished(cell.client, cell.start())["state"] == "succeeded"
    wait_until(lambda: cell.state()["robot"]["at_home"] is True)


def test_a_stop_during_a_capture_keeps_camera_and_recognition_for_the_next_scan(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera is suspended in a capture, which no stop interrupts, for longer than the stopped scan may take."""
    grace_s = 2.0  # enough for a busy machine
    monkeypatch.setattr("service.jobs.manager.GRACE_S", grace_s)
    cell.is_well()
    wait_until(lambda: cell.client.get("/readyz").status_code == 200)
    recognition, camera = cell.client.recognition_pid, cell.camera.pid
    assert camera is not None
    requested_s, location = time.monotonic(), cell.start()
    wait_until(lambda: "moving" in cell.views(location).values())
    os.kill(camera, signal.SIGSTOP)
    try:
        wait_until(lambda: at_rest_for_s(cell, requested_s) > 0.3)
        stopped_s = time.monotonic()
        assert cell.client.post("/api/cell/stop").status_code == 200
        time.sleep(max(stopped_s + grace_s + 1.0 - time.monotonic(), 0.0))
        assert cell.client.get(location).json()["final"] is False
    finally:
        os.kill(camera, signal.SIGCONT)
    assert finished(cell.client, location)["state"] == "aborted"
    assert cell.events("motion_start", after_s=stopped_s) == []
    assert finished(cell.client, cell.start())["state"] == "succeeded"
    assert (cell.client.recognition_pid, cell.camera.pid) == (recognition, camera)


def at_rest_for_s(cell: LiveCell, since_s: float) -> float:
    """Return the time since the last move after `since_s` (monotonic seconds), or 0 during it and before the first."""
    moves = cell.events("motion_start", "motion_done", after_s=since_s)
    return time.monotonic() - moves[-1]["stamp_s"] if moves and moves[-1]["kind"] == "motion_done" else 0.0


def test_the_plan_is_available_before_a_device_is_connected(serve: Serve, tmp_path: Path) -> None:
    with live_cell(serve, tmp_path / "data") as cell:
        plan = cell.client.post("/api/viewpoints/plan", json={"views": 4}).json()
        assert [viewpoint["reason"] for viewpoint in plan["viewpoints"]] == [None] * 4
        assert math.isfinite(plan["travel_rad"])
        json.dumps(plan, allow_nan=False)
        picture = cell.client.get("/api/viewpoints/plan.png?views=4")
        assert picture.headers["content-type"] == "image/png"
        assert picture.content.startswith(b"\x89PNG")
        assert cell.state()["state"] == "not_ready"
        assert cell.state()["viewpoints"]["reachable"] == 4
