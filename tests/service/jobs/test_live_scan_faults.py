"""Live scans over HTTP with an invalid calibration or a hanging recognition: refusals, and the views that are kept."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx2
import pytest

from calibration.storage.hand_eye_file import write_hand_eye
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from tests.service.conftest import Serve
from tests.service.live_cell import SCAN, LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

RECOGNITION_S = 10.0
"""Time limit of recognition, seconds. A good scan takes a fraction of it, even on a busy machine."""


@pytest.fixture(scope="module")
def hand_eye(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the calibration file of the shared cell."""
    file = tmp_path_factory.mktemp("calibration") / "hand_eye.json"
    write_hand_eye(file, T_FLANGE_CAMERA, created=datetime.now(UTC))
    return file


@pytest.fixture(scope="module")
def cell(serve: Serve, hand_eye: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that moves slowly enough for an action during a move. Each test leaves it ready to scan."""
    data, limits = tmp_path_factory.mktemp("data"), {"recognition_s": RECOGNITION_S}
    with live_cell(serve, data, time_factor=5.0, hand_eye={"file": hand_eye}, limits=limits) as shared:
        yield shared


@pytest.fixture
def calibrated(hand_eye: Path) -> Iterator[Path]:
    """Yield the calibration file, which the test may change, and restore it afterwards."""
    content = hand_eye.read_bytes()
    yield hand_eye
    hand_eye.write_bytes(content)


def recorded_views(cell: LiveCell, scan: dict[str, Any]) -> int:
    """Return the number of recorded views of the scan, and check that its recording has as many."""
    count = [view["state"] for view in scan["progress"]["views"]].count("recorded")
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == count
    return count


@pytest.mark.fault(17)
def test_a_missing_or_old_calibration_is_refused_before_the_arm_moves(
    cell: LiveCell, calibrated: Path, assert_problem: Problem
) -> None:
    before, scans = time.monotonic(), cell.client.get("/api/scans").json()
    calibrated.unlink()
    assert calibrated.name in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
    assert_problem(cell.client.post("/api/viewpoints/plan", json={}), 409, "calibration")
    write_hand_eye(calibrated, T_FLANGE_CAMERA, created=datetime.now(UTC) - timedelta(days=91))
    assert "max_age_days" in assert_problem(cell.client.post("/api/scans", json=SCAN), 409, "calibration")
    write_hand_eye(calibrated, T_FLANGE_CAMERA, created=datetime.now(UTC), robot_serial="of another")
    assert cell.client.get("/api/scans").json() == scans
    slug, detail = cell.failure()  # the arm has to be connected first, and says its number then
    assert slug == "calibration"
    assert "of another" in detail
    assert cell.events("motion_start", after_s=before) == []


@pytest.mark.fault(17)
def test_a_change_of_the_calibration_during_a_scan_fails_the_scan(
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
    assert 1 <= recorded_views(cell, scan) < 8


def test_a_hanging_recognition_is_killed_and_the_views_are_kept(cell: LiveCell, finished: Finished) -> None:
    location = cell.start()
    cell.wait_for_motion(location)
    recognition = cell.client.recognition_pid
    os.kill(recognition, signal.SIGSTOP)
    scan = finished(cell.client, location)
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:recognition-timeout")
    assert recorded_views(cell, scan) == 8
    assert cell.state()["state"] == "ready"  # the arm is at home and was not stopped
