"""Live scans over HTTP that go wrong: what is refused, what fails, what is kept, and who must look at the cell."""

import multiprocessing
import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from calibration.storage import write_hand_eye
from cell.simulation.poses import T_FLANGE_CAMERA
from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx.Client, str], dict[str, Any]]
Problem = Callable[[httpx.Response, int, str], str]

RECOGNITION_S = 10.0
"""As a limit. A good scan takes a fraction of it, on a busy machine too."""


@pytest.fixture(scope="module")
def hand_eye(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The calibration file of the shared cell."""
    file = tmp_path_factory.mktemp("calibration") / "hand_eye.json"
    write_hand_eye(file, T_FLANGE_CAMERA, created=datetime.now(UTC))
    return file


@pytest.fixture(scope="module")
def cell(serve: Serve, hand_eye: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell slow enough to be caught in motion; each test leaves it able to scan."""
    data, limits = tmp_path_factory.mktemp("data"), {"recognition_s": RECOGNITION_S}
    with live_cell(serve, data, time_factor=5.0, hand_eye={"file": hand_eye}, limits=limits) as shared:
        yield shared


@pytest.fixture
def calibrated(hand_eye: Path) -> Iterator[Path]:
    """The calibration file, to do with it what one likes."""
    content = hand_eye.read_bytes()
    yield hand_eye
    hand_eye.write_bytes(content)


def taken(cell: LiveCell, scan: dict[str, Any]) -> int:
    """How many views the scan tells, and its recording holds."""
    count = [view["state"] for view in scan["progress"]["views"]].count("recorded")
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == count
    return count


def counted(cell: LiveCell) -> dict[tuple[str, str], float]:
    """The metrics of views, by name and label."""
    told = re.findall(r'^pointchain_(views?_\w*total)\{\w+="(\w+)"\} (\S+)', cell.client.get("/metrics").text, re.M)
    return {(name, label): float(value) for name, label, value in told}


def test_a_protective_stop_needs_a_person(cell: LiveCell, finished: Finished, assert_problem: Problem) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    cell.controller.protective_stop()
    scan = finished(cell.client, location)
    assert scan["state"] == "failed"
    assert scan["problem"]["type"] == "urn:pointchain:protective-stop"
    assert taken(cell, scan) >= 1
    assert cell.state()["state"] == "fault"
    assert cell.state()["robot"]["safety_mode"] == "protective_stop"
    # Planning, which anybody may do at any moment, makes no fault forgotten.
    assert cell.client.post("/api/viewpoints/plan", json={"views": 2}).status_code == 200
    assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
    assert_problem(cell.client.post("/api/cell/connect"), 409, "acknowledge-required")

    def acknowledged() -> bool:
        answer = cell.client.post("/api/cell/acknowledge")
        if answer.status_code != 200:
            assert_problem(answer, 409, "too-early")
        return answer.status_code == 200

    wait_until(acknowledged)
    assert cell.state()["state"] == "not_ready"
    assert not cell.moving()
    assert_problem(cell.client.post("/api/cell/acknowledge"), 409, "no-fault")
    cell.is_well()


@pytest.mark.parametrize("fault", ["drop", "freeze"])
def test_a_lost_robot_fails_the_scan_and_is_a_fault(
    cell: LiveCell, finished: Finished, assert_problem: Problem, fault: str
) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    getattr(cell.controller, fault)()
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:robot-lost")
    assert taken(cell, scan) >= 1
    assert cell.state()["robot"]["moving"] is None, "nobody knows"
    assert cell.state()["reason"].startswith("look at the cell and acknowledge first: ")
    assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "acknowledge-required")
    assert_problem(cell.client.post("/api/cell/release"), 409, "acknowledge-required")
    cell.controller.clear()
    assert cell.client.post("/api/cell/acknowledge").status_code == 200
    cell.is_well()


@pytest.mark.parametrize("fault", ["local_mode", "foreign_program"])
def test_a_robot_that_is_not_ours_is_left_alone(cell: LiveCell, assert_problem: Problem, fault: str) -> None:
    cell.client.post("/api/cell/connect")
    cell.client.post("/api/cell/stop")
    before = time.monotonic()
    getattr(cell.controller, fault)()
    assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "robot-not-ready")
    assert cell.state()["state"] == "not_ready"
    assert cell.events("script_upload", "motion_start", after_s=before) == []
    cell.controller.clear()
    if fault == "foreign_program":
        cell.controller.reset()  # somebody ends it at the pendant
    cell.is_well()


def test_a_missing_or_old_calibration_is_refused_before_anything_moves(
    cell: LiveCell, calibrated: Path, assert_problem: Problem
) -> None:
    before, scans = time.monotonic(), cell.client.get("/api/scans").json()
    calibrated.unlink()
    assert calibrated.name in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
    assert_problem(cell.client.post("/api/viewpoints/plan", json={}), 409, "calibration")
    write_hand_eye(calibrated, T_FLANGE_CAMERA, created=datetime.now(UTC) - timedelta(days=91))
    assert "max_age_days" in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
    write_hand_eye(calibrated, T_FLANGE_CAMERA, created=datetime.now(UTC), robot_serial="of another")
    assert "of another" in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
    assert cell.events("motion_start", after_s=before) == []
    assert cell.client.get("/api/scans").json() == scans


def test_a_calibration_that_changes_during_the_scan_fails_it(
    cell: LiveCell, calibrated: Path, finished: Finished
) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    moved = T_FLANGE_CAMERA.copy()
    moved[0, 3] += 0.001
    write_hand_eye(calibrated, moved, created=datetime.now(UTC))
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:calibration")
    assert not cell.moving()
    assert 1 <= taken(cell, scan) < 8


def test_a_camera_that_fails_for_a_while_makes_a_partial_result(cell: LiveCell, finished: Finished) -> None:
    before = counted(cell)
    location = cell.start()
    cell.wait_for_motion(location)
    cell.camera.fault("zero")
    wait_until(lambda: "missing" in cell.views(location).values())
    cell.camera.fault("none")
    scan = finished(cell.client, location)
    assert scan["state"] == "partial", scan
    missing = [view for view in scan["progress"]["views"] if view["state"] == "missing"]
    assert taken(cell, scan) == 8 - len(missing)
    warnings = cell.client.get(scan["links"]["model"]).json()["quality"]["warnings"]
    for view in missing:
        assert view["reason"]
        assert any(f"view {view['index']} is missing" in warning for warning in warnings)
    more = {name: value - before[name] for name, value in counted(cell).items()}
    assert more["views_total", "recorded"] == 8 - len(missing)
    assert more["views_total", "missing"] == more["view_failures_total", "camera"] == len(missing)


def test_too_few_views_fail_the_scan_and_are_kept(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    cell.camera.fault("zero")
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:insufficient-views")
    assert 1 <= taken(cell, scan) < 4
    cell.camera.fault("none")
    wait_until(lambda: cell.state()["state"] != "busy")
    assert cell.state()["problem"] == "urn:pointchain:insufficient-views"
    cell.is_well()  # the arm has gone home, and the next scan may be better


def test_recognition_that_hangs_is_ended_and_the_views_are_kept(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    (recognition,) = [child.pid for child in multiprocessing.active_children() if child.name == "recognition"]
    assert recognition is not None
    os.kill(recognition, signal.SIGSTOP)
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:recognition-timeout")
    assert taken(cell, scan) == 8
    assert cell.state()["state"] == "ready"  # home, and not stopped for it
