"""Calibration over HTTP: the simulated cell captures its board, and the result becomes the active calibration."""

import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import numpy as np
import pytest

from calibration.geometry.transforms import from_quaternion, inverse, rotation_angle
from cell.simulation.devices.world import simulated_world
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from tests.service.conftest import Serve
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]

RUNS = "/api/calibration/runs"


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that the tests of this module share. Each test leaves it without a fault."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=50.0) as shared:
        yield shared


def begin(cell: LiveCell, path: str = RUNS, **body: Any) -> str:
    """Start a calibration or a verification, which must be accepted, and return its address."""
    answer = cell.client.post(path, json=body) if path == RUNS else cell.client.post(path)
    assert answer.status_code == 202, answer.text
    return answer.headers["Location"]


def nominal_sha256(cell: LiveCell) -> str:
    """Return the hash of the nominal calibration, which is in use until another one is activated."""
    return simulated_world(cell.settings).nominal_hand_eye.sha256


@pytest.fixture(scope="module")
def calibrated(cell: LiveCell, finished: Finished) -> dict[str, Any]:
    """Return the document of a succeeded run whose result is not active."""
    before = cell.client.get("/api/calibration").json()
    assert (before["active_run"], before["reason"]) == (None, None)
    assert before["calibration"]["sha256"] == nominal_sha256(cell)
    location = begin(cell, poses=12)
    assert cell.client.get("/api/calibration").json()["active_run"] == location
    run = finished(cell.client, location)
    assert run["state"] == "succeeded", run
    return run


def test_a_run_reports_its_views_and_finds_the_true_mounting(cell: LiveCell, calibrated: dict[str, Any]) -> None:
    assert (calibrated["kind"], calibrated["poses"], calibrated["problem"]) == ("calibration", 12, None)
    assert calibrated["board"]["kind"] == "charuco"
    assert calibrated["progress"]["fraction"] == 1.0
    assert calibrated["progress"]["coverage"] > 0.3
    views = calibrated["progress"]["views"]
    assert len(views) == 14  # two more for the verification
    for view in views:
        assert (view["state"], view["reason"], view["board_corners"]) == ("recorded", None, 48)
        assert view["corners"] > 24
        # The corners of the simulated camera are exact to a tenth of a pixel.
        assert 0 < view["rms_px"] < 0.3
        assert view["cells"] == sorted(set(view["cells"]))
    cells = {cell for view in views for cell in view["cells"]}
    assert calibrated["progress"]["coverage"] == len(cells) / 40
    picture = cell.client.get(views[3]["image"])
    assert picture.headers["content-type"] == "image/png"
    assert picture.content.startswith(b"\x89PNG")
    result = calibrated["result"]
    assert result["verdict"] in ("accept", "warn"), result["findings"]
    assert len(result["views"]) == 12
    T = from_quaternion(result["T_flange_camera"]["xyz_m"], result["T_flange_camera"]["quat_xyzw"], "the result")
    off = inverse(T_FLANGE_CAMERA) @ T
    # Four of the reported standard deviations, all axes together.
    assert np.linalg.norm(off[:3, 3]) < 4 * result["metrics"]["sigma_m"]
    assert rotation_angle(off) < 4 * result["metrics"]["sigma_rad"]
    assert result["metrics"]["sigma_m"] < 0.001
    assert calibrated["verification"]["passed"]
    assert len(calibrated["verification"]["views"]) == 2


def test_an_activated_result_is_in_use_and_can_be_verified(
    cell: LiveCell, calibrated: dict[str, Any], finished: Finished, assert_problem: Problem
) -> None:
    answer = cell.client.post(calibrated["links"]["activate"])
    assert answer.status_code == 200, answer.text
    assert answer.json()["activated_at"] is not None
    now = cell.client.get("/api/calibration").json()
    in_use = now["calibration"]
    assert in_use["sha256"] != nominal_sha256(cell)
    assert in_use["T_flange_camera"][0][3] == pytest.approx(calibrated["result"]["T_flange_camera"]["xyz_m"][0])
    assert in_use["repeatability_95_m"] == calibrated["result"]["metrics"]["repeatability_95_m"]
    assert in_use["sigma_m"] == pytest.approx(calibrated["result"]["metrics"]["sigma_m"])
    assert in_use["verdict"] == calibrated["result"]["verdict"]
    assert 0 <= in_use["age_s"] < 3600
    assert (in_use["drift"]["scans"], in_use["drift"]["drifted"], now["warnings"]) == (0, False, [])

    check = finished(cell.client, begin(cell, "/api/calibration/verify"))
    assert check["state"] == "succeeded", check
    assert (check["kind"], check["result"]) == ("verification", None)
    assert check["verification"]["passed"], check["verification"]
    assert check["calibration_sha256"] == in_use["sha256"]
    assert [view["state"] for view in check["progress"]["views"]] == ["recorded"] * 2
    assert check["links"]["activate"] is None
    assert_problem(cell.client.post(f"{check['links']['self']}/activate"), 409, "not-activatable")

    scan = finished(cell.client, cell.start())
    assert scan["state"] == "succeeded", scan
    recording = cell.client.get(f"/api/recordings/{scan['recording']}").json()
    assert recording["provenance"]["calibration_sha256"] == in_use["sha256"]
    answer = cell.client.post("/api/scans", json={"mode": "replay", "recording": scan["recording"]})
    assert finished(cell.client, answer.headers["Location"])["state"] == "succeeded"
    assert cell.client.get("/api/calibration").json()["calibration"]["drift"]["scans"] == 1, "a replay does not count"
    assert cell.state()["warnings"] == []


def test_a_failed_verification_is_a_warning_until_another_calibration_is_active(
    cell: LiveCell, calibrated: dict[str, Any], finished: Finished
) -> None:
    assert cell.client.post(calibrated["links"]["activate"]).status_code == 200
    active = cell.settings.hand_eye.active_file
    assert active is not None
    document = json.loads(active.read_text())
    document["T_flange_camera"]["xyz_m"][0] += 0.008
    active.write_text(json.dumps(document))
    check = finished(cell.client, begin(cell, "/api/calibration/verify"))
    assert (check["state"], check["verification"]["passed"]) == ("succeeded", False)
    for warnings in (cell.state()["warnings"], cell.client.get("/api/calibration").json()["warnings"]):
        (warning,) = warnings
        assert warning["code"] == "verification-failed"
        assert check["verification"]["message"] in warning["message"]
    assert cell.client.post(calibrated["links"]["activate"]).status_code == 200
    assert cell.state()["warnings"] == []


def test_a_folder_that_cannot_be_created_fails_the_run_before_the_arm_moves(cell: LiveCell, finished: Finished) -> None:
    kept = cell.settings.hand_eye.folder
    assert kept is not None
    runs, aside = kept / "runs", kept / "aside"
    before = time.monotonic()
    if runs.exists():
        runs.rename(aside)
    runs.write_text("no folder")
    try:
        run = finished(cell.client, begin(cell, poses=12))
    finally:
        runs.unlink()
        if aside.exists():
            aside.rename(runs)
    assert (run["state"], run["problem"]["type"], run["problem"]["status"]) == ("failed", "urn:pointchain:file", 507)
    assert f"{runs}" in run["problem"]["detail"]
    assert cell.events("motion_start", after_s=before) == []


def test_a_cell_without_a_calibration_reports_that_one_was_activated(
    cell: LiveCell, calibrated: dict[str, Any]
) -> None:
    active = cell.settings.hand_eye.active_file
    assert active is not None
    active.parent.mkdir(exist_ok=True)
    active.write_text("{}")
    assert cell.client.post("/api/cell/connect").status_code == 409
    assert cell.state()["problem"] == "urn:pointchain:calibration"
    assert cell.client.post(calibrated["links"]["activate"]).status_code == 200
    state = cell.state()
    assert (state["state"], state["problem"]) == ("not_ready", "urn:pointchain:not-connected")
    assert "another calibration is in use now" in state["reason"]
    cell.is_well()
