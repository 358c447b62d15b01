"""Calibration routes without a moving arm: refusals, the state after a restart, and the drift."""

import json
import sqlite3
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from calibration.target.board import Board
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.control.progress import BoardObservation
from cell.simulation.devices.world import simulated_world
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.request import RecognitionRequest
from service.jobs.submission import NOBODY, new_calibration, new_scan
from service.states import ACTIVE_STATES, ScanState
from service.storage.data_folder import DataFolder
from service.storage.database import new_id
from service.storage.rows import CalibrationRow, ScanErrorRow
from service.storage.store import Store
from tests.service.conftest import Serve, ServedClient
from tests.service.security.conftest import without_recognition

Problem = Callable[[httpx2.Response, int, str], str]

RUNS = "/api/calibration/runs"
CAMERA = SimulatedCamera(model="exact")
DRIFTED = np.array([0.0, 0.0, 0.0, 0.0, 0.004, 0.0])

REFUSED: dict[str, Any] = {
    "verdict": "refuse",
    "findings": [{"code": "parallel-axes", "message": "all turns are about one axis: tilt it too", "blocking": True}],
    "T_flange_camera": None,
    "T_base_board": None,
    "covariance": {"matrix": [[None] * 6] * 6, "order": [], "convention": "", "units": []},
    "intrinsics": {},
    "board": Board().to_json(),
    "metrics": dict.fromkeys(
        (
            "sigma_m", "sigma_rad", "repeatability_95_m", "loo_error_m", "pixel_sigma_px", "robot_sigma_m",
            "robot_sigma_rad",
        )
    )
    | {"views_given": 12, "views_used": 0},
    "views": [],
}  # fmt: skip
"""Result of a solver that found no solution."""


def nominal_sha256() -> str:
    """Return the hash of the nominal calibration, which the simulated cell has in place of a file."""
    return simulated_world(CellSettings(camera=CAMERA)).nominal_hand_eye.sha256


def run_in_state(state: ScanState, **values: Any) -> CalibrationRow:
    return replace(new_calibration("calibration", Board(), 12), id=new_id(), state=state, **values)


@pytest.fixture(scope="module")
def earlier_runs() -> dict[str, CalibrationRow]:
    """Return the runs that an earlier service has left."""
    return {state: run_in_state(state) for state in ACTIVE_STATES} | {
        "refused": run_in_state("succeeded", result=REFUSED)
    }


@pytest.fixture(scope="module")
def client(
    serve: Serve, earlier_runs: dict[str, CalibrationRow], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServedClient]:
    root = tmp_path_factory.mktemp("data")
    with closing(DataFolder(root)) as folder, closing(Store(folder)) as store:
        for row in earlier_runs.values():
            store.calibrations.add(row)
        store.calibrations.set_view(earlier_runs["scanning"].id, 0, "recorded")
        store.calibrations.update_view(
            earlier_runs["scanning"].id, 0, **asdict(BoardObservation(40, 48, 0.12, (3, 4, 11)))
        )
        store.calibrations.set_view(earlier_runs["scanning"].id, 1, "moving")
        information = np.diag([1e6] * 3 + [4e6] * 3)
        for _ in range(3):
            scan = new_scan("live", RecognitionRequest(), NOBODY)
            store.scans.add(replace(scan, state="succeeded"))
            error = ScanErrorRow(
                scan.id, nominal_sha256(), DRIFTED.tolist(), information.tolist(), (information @ DRIFTED).tolist()
            )
            store.calibrations.add_scan_error(error)
    with without_recognition(serve, root, camera=CAMERA) as client:
        yield client


@pytest.mark.parametrize("state", ACTIVE_STATES)
@pytest.mark.problem("interrupted")
def test_runs_of_a_killed_service_are_interrupted(
    client: httpx2.Client, earlier_runs: dict[str, CalibrationRow], state: str
) -> None:
    run = client.get(f"{RUNS}/{earlier_runs[state].id}").json()
    assert (run["state"], run["problem"]["type"]) == ("interrupted", "urn:pointchain:interrupted")
    assert run["ended_at"] is not None
    assert (run["links"]["cancel"], run["links"]["activate"]) == (None, None)
    if state == "scanning":
        first, second = run["progress"]["views"]
        assert (first["state"], first["corners"], first["board_corners"]) == ("recorded", 40, 48)
        assert (first["rms_px"], first["cells"]) == (0.12, [3, 4, 11])
        assert (second["rms_px"], second["cells"]) == (None, None)
        assert (second["state"], second["image"]) == ("missing", None)


def test_runs_are_listed_the_newest_first(client: httpx2.Client, earlier_runs: dict[str, CalibrationRow]) -> None:
    ids = [run["id"] for run in client.get(RUNS).json()["runs"]]
    assert ids == sorted((row.id for row in earlier_runs.values()), reverse=True)
    assert [run["id"] for run in client.get(f"{RUNS}?limit=2&before={ids[1]}").json()["runs"]] == ids[2:4]


@pytest.mark.problem("not-cancellable")
def test_a_refused_or_missing_result_is_not_activated(
    client: httpx2.Client, earlier_runs: dict[str, CalibrationRow], assert_problem: Problem
) -> None:
    before = client.get("/api/calibration").json()
    refused = client.get(f"{RUNS}/{earlier_runs['refused'].id}").json()
    assert (refused["result"]["verdict"], refused["links"]["activate"]) == ("refuse", None)
    detail = assert_problem(client.post(f"{RUNS}/{earlier_runs['refused'].id}/activate"), 409, "calibration-refused")
    assert "all turns are about one axis" in detail
    assert_problem(client.post(f"{RUNS}/{earlier_runs['scanning'].id}/activate"), 409, "not-activatable")
    assert_problem(client.post(f"{RUNS}/none/activate"), 404, "calibration-not-found")
    assert_problem(client.post(f"{RUNS}/{earlier_runs['refused'].id}/cancel"), 409, "not-cancellable")
    assert client.get("/api/calibration").json() == before


@pytest.mark.parametrize(
    ("wanted", "slug", "message"),
    [
        ({"board": {"pitch_m": 25.0}}, "calibration-board", "millimetres"),
        ({"board": {"kind": "charuco", "rows": 6}}, "calibration-board", "odd number"),
        ({"board": {"kind": "stripes"}}, "invalid-request", "board.kind"),
        ({"board": {"pitch": 0.025}}, "invalid-request", "board.pitch"),
        ({"poses": 3}, "invalid-request", "poses"),
    ],
)
def test_an_impossible_board_or_number_of_poses_is_refused(
    client: httpx2.Client, assert_problem: Problem, wanted: dict[str, Any], slug: str, message: str
) -> None:
    assert message in assert_problem(client.post(RUNS, json=wanted), 422, slug)


def test_a_missing_view_or_run_is_not_found(
    client: httpx2.Client, earlier_runs: dict[str, CalibrationRow], assert_problem: Problem
) -> None:
    assert_problem(client.get(f"{RUNS}/{earlier_runs['scanning'].id}/views/7.png"), 404, "no-result")
    assert_problem(client.get(f"{RUNS}/{earlier_runs['scanning'].id}/views/-1.png"), 422, "invalid-request")
    assert_problem(client.get(f"{RUNS}/none"), 404, "calibration-not-found")


def test_a_drift_is_reported_by_calibration_and_cell(client: httpx2.Client) -> None:
    status = client.get("/api/calibration").json()
    assert status["calibration"]["sha256"] == nominal_sha256()
    drift = status["calibration"]["drift"]
    assert (drift["scans"], drift["drifted"]) == (3, True)
    # 3.97 of the 4 mm, because the prior has little weight here
    assert drift["deviation_m"] == pytest.approx(0.004, rel=0.02)
    assert drift["reference"] == "calibration"
    for warnings in (status["warnings"], client.get("/api/cell").json()["warnings"]):
        (warning,) = warnings
        assert warning["code"] == "calibration-drift"
        assert warning["message"] == drift["message"]
        assert "4.0 mm" in warning["message"]
    json.dumps(status, allow_nan=False)


def test_a_verification_needs_the_board_of_a_calibration(client: httpx2.Client, assert_problem: Problem) -> None:
    assert "calibrat" in assert_problem(client.post("/api/calibration/verify"), 409, "calibration")


def test_an_unusable_file_is_the_reason_and_no_warning(serve: Serve, tmp_path: Path) -> None:
    file = tmp_path / "hand_eye.json"
    file.write_text("{}")
    with without_recognition(serve, tmp_path / "data", hand_eye={"file": file}) as client:
        status = client.get("/api/calibration").json()
        assert status["calibration"] is None
        assert "T_flange_camera" in status["reason"]
        assert (status["warnings"], client.get("/api/cell").json()["warnings"]) == ([], [])


def test_a_stop_does_not_wait_for_the_drift_estimate_of_a_scan(client: ServedClient) -> None:
    context = client.app.state.context
    # this request judges the drift; the response to a stop has the latest judgement
    assert [warning["code"] for warning in client.get("/api/cell").json()["warnings"]] == ["calibration-drift"]
    scan = client.get("/api/scans").json()["scans"][0]["id"]
    error = HandEyeErrorEstimate(np.eye(6), np.zeros(6), np.zeros(6))
    with closing(sqlite3.connect(context.store.folder.database, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with ThreadPoolExecutor(1) as pool:
            kept = pool.submit(context.jobs.drift.add, scan, nominal_sha256(), error)
            while not kept.running():
                time.sleep(0.01)
            stopped = client.post("/api/cell/stop").json()
            assert not kept.done(), "the database must be locked"
            other.execute("ROLLBACK")
            with pytest.raises(sqlite3.IntegrityError):  # the estimate of this scan exists already
                kept.result()
    assert [warning["code"] for warning in stopped["warnings"]] == ["calibration-drift"]
