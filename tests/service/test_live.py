"""Live scans over HTTP: the real ur_rtde and depthai in child processes, against the virtual controller."""

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from calibration.storage import write_hand_eye
from cell.settings import SimulatedArm, SimulatedCamera
from cell.simulation.controller.admin import AdminClient
from tests.cell.loopback import free_host
from tests.service.conftest import Serve, wait_until

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx.Client, str], dict[str, Any]]
Problem = Callable[[httpx.Response, int, str], str]

FAST: dict[str, Any] = {"fps": 30.0, "exposures": 1, "settle_s": 0.0}
SCAN = {"mode": "live", "string_radius_m": 0.0042}


class LiveCell:
    """A service with a simulated cell, and the way to its controller's faults."""

    def __init__(self, client: httpx.Client, host: str) -> None:
        self.client = client
        self.controller = AdminClient(host)

    def start(self, **wanted: Any) -> str:
        """Starts a live scan; its address."""
        answer = self.client.post("/api/scans", json=SCAN | wanted)
        assert answer.status_code == 202, answer.text
        return answer.headers["Location"]

    def views(self, location: str) -> dict[int, str]:
        """The state of each viewpoint come to so far."""
        return {view["index"]: view["state"] for view in self.client.get(location).json()["progress"]["views"]}

    def wait_for_motion(self, location: str, views: int = 1) -> None:
        """Until so many views are recorded and the arm is on its way to the next."""

        def under_way() -> bool:
            states = list(self.views(location).values())
            assert self.client.get(location).json()["state"] in ("queued", "preflight", "scanning")
            return states.count("recorded") >= views and "moving" in states and self.moving()

        wait_until(under_way)

    def moving(self) -> bool:
        """The controller's own word."""
        return self.controller.state().moving

    def events(self, *kinds: str, after_s: float = 0.0) -> list[dict[str, Any]]:
        """What the controller has noted of these kinds."""
        return [event for event in self.controller.log() if event["kind"] in kinds and event["stamp_s"] > after_s]

    def state(self) -> dict[str, Any]:
        """The cell's document."""
        return self.client.get("/api/cell").json()


@contextmanager
def live_cell(serve: Serve, data: Path, time_factor: float = 20.0, **settings: Any) -> Iterator[LiveCell]:
    host = free_host()
    # A busy machine may keep a thread of ours waiting for longer than the default watchdog does.
    arm = SimulatedArm(host=host, time_factor=time_factor, watchdog_hz=1.0)
    camera = settings.pop("camera", None) or SimulatedCamera(model="ideal", **FAST)
    with serve(data, arm=arm, camera=camera, **settings) as client:
        cell = LiveCell(client, host)
        try:
            yield cell
        finally:
            cell.controller.close()


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell that many tests share; each leaves it without a fault."""
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


def test_a_live_scan_gives_the_true_model_and_replays_to_the_same(
    cell: LiveCell, finished: Finished, tmp_path: Path
) -> None:
    location = cell.start()
    scan = finished(cell.client, location)
    assert scan["state"] == "succeeded", scan
    assert scan["problem"] is None
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
    assert recording["missing"] == []
    answer = cell.client.post("/api/scans", json={"mode": "replay", "recording": scan["recording"]})
    again = finished(cell.client, answer.headers["Location"])
    replayed = cell.client.get(again["links"]["model"]).json()
    for each in (model, replayed):
        each.pop("timing_s")
    assert replayed == model


def test_the_cell_tells_what_it_is_made_of(cell: LiveCell, finished: Finished) -> None:
    finished(cell.client, cell.start())
    wait_until(lambda: cell.state()["state"] == "ready")  # the arm is home
    state = cell.state()
    assert (state["state"], state["reason"], state["problem"]) == ("ready", None, None)
    assert state["robot"]["model"] == "ur5e"
    assert (state["robot"]["robot_mode"], state["robot"]["safety_mode"]) == ("running", "normal")
    assert len(state["robot"]["q_rad"]) == 6
    assert state["camera"]["width"] == 640
    assert state["calibration"]["sha256"]
    assert state["viewpoints"] == {"planned": 8, "reachable": 8, "missing": []}


def test_while_one_scan_runs_a_second_is_told_which(
    cell: LiveCell, assert_problem: Problem, finished: Finished
) -> None:
    location = cell.start()
    answer = cell.client.post("/api/scans", json=SCAN)
    assert_problem(answer, 409, "cell-busy")
    assert answer.headers["Location"] == location
    assert finished(cell.client, location)["state"] == "succeeded"


def test_cancel_stops_the_arm_and_keeps_the_views(serve: Serve, tmp_path: Path, finished: Finished) -> None:
    with live_cell(serve, tmp_path / "data", time_factor=5.0) as cell:
        location = cell.start()
        cell.wait_for_motion(location)
        before = time.monotonic()
        answer = cell.client.post(f"{location}/cancel")
        assert answer.json()["state"] == "aborted", answer.text
        assert answer.json()["problem"]["type"] == "urn:pointchain:aborted"
        taken = list(cell.views(location).values()).count("recorded")
        assert cell.client.get(f"/api/recordings/{answer.json()['recording']}").json()["views"] == taken
        wait_until(lambda: not cell.moving())
        braking = cell.events("braking", after_s=before)
        assert braking, "the arm was not stopped"
        assert cell.events("motion_start", after_s=braking[0]["stamp_s"]) == []
        assert cell.state()["problem"] == "urn:pointchain:stopped"
        # Whoever asks for a scan again gets one.
        assert finished(cell.client, cell.start())["state"] == "succeeded"


def test_stop_aborts_the_scan_and_works_when_nothing_runs(serve: Serve, tmp_path: Path, finished: Finished) -> None:
    with live_cell(serve, tmp_path / "data", time_factor=5.0) as cell:
        assert cell.client.post("/api/cell/stop").status_code == 200
        location = cell.start()
        cell.wait_for_motion(location, views=0)
        assert cell.client.post("/api/cell/stop").status_code == 200
        assert finished(cell.client, location)["state"] == "aborted"
        assert cell.state()["state"] == "not_ready"
        assert cell.client.post("/api/cell/stop").status_code == 200
        assert cell.client.post("/api/cell/connect").json()["state"] == "ready"


def test_a_protective_stop_needs_a_person(
    serve: Serve, tmp_path: Path, finished: Finished, assert_problem: Problem
) -> None:
    with live_cell(serve, tmp_path / "data", time_factor=5.0) as cell:
        location = cell.start()
        cell.wait_for_motion(location)
        cell.controller.protective_stop()
        scan = finished(cell.client, location)
        assert scan["state"] == "failed"
        assert scan["problem"]["type"] == "urn:pointchain:protective-stop"
        assert cell.state()["state"] == "fault"
        assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
        assert_problem(cell.client.post("/api/cell/connect"), 409, "acknowledge-required")
        assert_problem(cell.client.post("/api/cell/acknowledge"), 409, "too-early")

        def acknowledged() -> bool:
            answer = cell.client.post("/api/cell/acknowledge")
            assert answer.status_code in (200, 409), answer.text
            return answer.status_code == 200

        wait_until(acknowledged)
        assert cell.state()["state"] == "not_ready"
        assert not cell.moving()
        assert_problem(cell.client.post("/api/cell/acknowledge"), 409, "no-fault")
        assert finished(cell.client, cell.start())["state"] == "succeeded"


@pytest.mark.parametrize("fault", ["drop", "freeze"])
def test_a_lost_robot_fails_the_scan_and_is_a_fault(
    serve: Serve, tmp_path: Path, finished: Finished, assert_problem: Problem, fault: str
) -> None:
    with live_cell(serve, tmp_path / "data", time_factor=5.0) as cell:
        location = cell.start()
        cell.wait_for_motion(location)
        getattr(cell.controller, fault)()
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:robot-lost")
        taken = list(cell.views(location).values()).count("recorded")
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == taken
        assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
        cell.controller.clear()
        assert cell.client.post("/api/cell/acknowledge").status_code == 200
        assert finished(cell.client, cell.start())["state"] == "succeeded"


def test_a_robot_in_local_mode_is_left_alone(cell: LiveCell, assert_problem: Problem, finished: Finished) -> None:
    finished(cell.client, cell.start())
    cell.client.post("/api/cell/stop")
    before = time.monotonic()
    cell.controller.local_mode()
    try:
        assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "robot-not-ready")
        assert cell.events("script_upload", after_s=before) == []
    finally:
        cell.controller.clear()
    assert finished(cell.client, cell.start())["state"] == "succeeded"


def test_a_missing_calibration_is_refused_before_anything_moves(
    serve: Serve, tmp_path: Path, assert_problem: Problem
) -> None:
    hand_eye = {"file": tmp_path / "nothing.json"}
    with live_cell(serve, tmp_path / "data", hand_eye=hand_eye) as cell:
        assert "nothing.json" in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
        assert_problem(cell.client.post("/api/viewpoints/plan", json={}), 409, "calibration")
        assert cell.client.get("/api/scans").json() == {"scans": []}


def test_a_calibration_that_changes_during_the_scan_fails_it(serve: Serve, tmp_path: Path, finished: Finished) -> None:
    from datetime import UTC, datetime

    from cell.simulation.poses import T_FLANGE_CAMERA

    file = tmp_path / "hand_eye.json"
    write_hand_eye(file, T_FLANGE_CAMERA, created=datetime.now(UTC))
    with live_cell(serve, tmp_path / "data", time_factor=5.0, hand_eye={"file": file}) as cell:
        location = cell.start()
        cell.wait_for_motion(location)
        moved = T_FLANGE_CAMERA.copy()
        moved[0, 3] += 0.001
        write_hand_eye(file, moved, created=datetime.now(UTC))
        scan = finished(cell.client, location)
        assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:calibration")
        assert not cell.moving()


def test_viewpoints_out_of_reach_are_refused_by_number(serve: Serve, tmp_path: Path, assert_problem: Problem) -> None:
    with live_cell(serve, tmp_path / "data", workspace={"x_m": (0.9, 1.2)}) as cell:
        answer = cell.client.post("/api/scans", json=SCAN)
        detail = assert_problem(answer, 422, "viewpoints-unreachable")
        assert "7: out of the arm's reach" in detail
        plan = cell.client.post("/api/viewpoints/plan", json={}).json()
        assert len(plan["viewpoints"]) == 8
        assert plan["viewpoints"][7]["reason"] == "out of the arm's reach"
        assert cell.client.get("/api/scans").json() == {"scans": []}
        assert not cell.moving()


def test_the_plan_is_shown_before_anything_is_connected(serve: Serve, tmp_path: Path) -> None:
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
