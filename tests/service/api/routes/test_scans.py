"""Scans over HTTP, from the request to the result, with refusals, cancels and crashes."""

import json
import math
import os
import signal
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording import RecordingHeader, RecordingWriter, read_recording
from recognition.model.document import ModelDocument
from service.api.schemas.grasps import GraspsDocument
from service.processing.worker import RecognitionWorker
from tests.service.conftest import PATIENCE_S, ServedClient, wait_until

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Serve = Callable[..., AbstractContextManager[httpx2.Client]]


def start(client: httpx2.Client, recording: str, **members: Any) -> str:
    """Start a scan, which must be accepted, and return its address."""
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording, **members})
    assert answer.status_code == 202, answer.text
    return answer.headers["location"]


def upload(client: httpx2.Client, path: Path) -> str:
    answer = client.post("/api/recordings", content=path.read_bytes())
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


def findings_of(client: httpx2.Client, scan: dict[str, Any], code: str) -> list[dict[str, Any]]:
    """Return the findings with a code in the model of a scan."""
    findings = client.get(scan["links"]["model"]).json()["quality"]["findings"]
    return [found for found in findings if found["code"] == code]


@pytest.mark.parametrize("method", ["matching", "enhanced"])
def test_a_recording_becomes_a_model(client: httpx2.Client, recording: str, finished: Finished, method: str) -> None:
    scan = finished(client, start(client, recording, method=method))
    assert scan["state"] == "succeeded", scan["problem"]
    assert (scan["method"], scan["string_radius_m"]) == (method, 0.0042)
    assert scan["summary"]["chains"] >= 1
    unknown = dict.fromkeys(("stage", "elapsed_s", "remaining_s"))
    assert scan["progress"] == unknown | {"fraction": 1.0, "views": []}
    assert scan["created_at"] <= scan["started_at"] <= scan["ended_at"]
    links = scan["links"]
    assert links["cancel"] is None
    model = client.get(links["model"])
    assert model.headers["content-type"] == "application/json"
    assert ModelDocument.model_validate_json(model.content).method == method
    assert len(model.json()["chains"]) == scan["summary"]["chains"]
    grasps = client.get(links["grasps"])
    GraspsDocument.model_validate_json(grasps.content)
    assert grasps.json()["grasps"] == [grasp | {"reach": None} for grasp in model.json()["grasps"]]
    assert client.get(links["cloud"]).content.startswith(b"ply\n")
    assert client.get(links["preview"]).content.startswith(b"\x89PNG")
    assert client.get(links["recording"]).content == client.get(f"/api/recordings/{recording}/file").content
    assert client.get("/api/scans").json()["scans"][0] == scan


def test_the_requested_radius_is_used(client: httpx2.Client, recording: str, finished: Finished) -> None:
    scan = finished(client, start(client, recording, string_radius_m=0.005))
    assert scan["string_radius_m"] == 0.005
    assert client.get(scan["links"]["model"]).json()["parameters"]["r_m"] == 0.005


def test_grasps_are_for_the_configured_gripper(
    serve: Serve, recording_file: Path, finished: Finished, tmp_path: Path
) -> None:
    gripper = {"stroke_m": 0.011, "opening_margin_m": 0.001}
    with serve(tmp_path, gripper=gripper) as client:
        scan = finished(client, start(client, upload(client, recording_file)))
        assert scan["state"] == "succeeded", scan["problem"]
        grasps = client.get(scan["links"]["grasps"]).json()["grasps"]
        # at least 2 r and the margin, at most the stroke; the default margin alone would need 12.4 mm
        assert all(0.0094 < grasp["opening_m"] <= 0.011 for grasp in grasps)
        reported = any("cannot be grasped" in found["message"] for found in findings_of(client, scan, "no-grasp"))
        assert reported == (not grasps)


def test_missing_views_make_a_partial_result(
    client: httpx2.Client, recording_file: Path, finished: Finished, tmp_path: Path
) -> None:
    content = recording_file.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) * 3 // 4])
    scan = finished(client, start(client, upload(client, cut)))
    assert scan["state"] == "partial"
    (incomplete,) = findings_of(client, scan, "recording-incomplete")
    assert incomplete["severity"] == "note"
    assert "the file ends" in incomplete["message"]


def test_unusable_colour_images_are_a_note_and_the_result_is_whole(
    client: httpx2.Client, recording_file: Path, finished: Finished, tmp_path: Path
) -> None:
    radius_m = read_recording(recording_file).header.string_radius_m

    def with_random_colour(view: View) -> View:
        return replace(view, colour_jpeg=np.random.default_rng(view.index).bytes(1000))

    path = rewrite(recording_file, tmp_path / "random-colour.mcap", radius_m, with_random_colour)
    recording = upload(client, path)
    assert client.get(f"/api/recordings/{recording}").json()["missing"] == []
    scan = finished(client, start(client, recording))
    assert scan["state"] == "succeeded"
    (note,) = findings_of(client, scan, "colour-unusable")
    assert note["severity"] == "note"
    assert note["message"] == (
        "views 0, 1, 2, 3: the colour image is no JPEG, though it has that format, so it is left out"
    )


def rewrite(source: Path, target: Path, radius_m: float | None, change: Callable[[View], View]) -> Path:
    """Write a copy of the recording with each view changed."""
    recording = read_recording(source)
    header = replace(recording.header, string_radius_m=radius_m)
    with RecordingWriter(target, header) as writer:
        for view in recording.views:
            writer.write_view(change(view))
    return target


def test_a_scan_without_a_string_has_a_note(
    client: httpx2.Client, finished: Finished, assert_problem: AssertProblem, tmp_path: Path
) -> None:
    K = np.array([[100.0, 0, 32], [0, 100, 20], [0, 0, 1]])
    T_base_flange = from_rotation_vector((0.0, 0.0, 0.3), (math.pi, 0.0, 0.0))
    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=0.004, T_flange_camera=np.eye(4))
    path = tmp_path / "bare-table.mcap"
    with RecordingWriter(path, header) as writer:
        for index in range(3):
            # straight down on the table from 0.3 m, with 0.1 mm of noise so that no image is constant
            depth = np.random.default_rng(index).integers(2999, 3002, (40, 64), dtype=np.uint16)
            writer.write_view(View(index, depth, 1e-4, K, T_base_flange, np.eye(4)))
    scan = finished(client, start(client, upload(client, path)))
    assert scan["state"] == "succeeded", scan["problem"]
    assert scan["summary"]["chains"] == 0
    assert len(findings_of(client, scan, "no-string-in-view")) == 1
    assert scan["summary"]["note_count"] >= 1
    assert client.get(scan["links"]["model"]).json()["chains"] == []
    assert client.get(scan["links"]["grasps"]).json()["grasps"] == []
    assert scan["links"]["height_map"] is None
    for ending in ("", ".png"):
        detail = assert_problem(client.get(scan["links"]["self"] + "/height-map" + ending), 404, "no-result")
        assert "no string was in view" in detail
    assert client.get(scan["links"]["preview"]).content.startswith(b"\x89PNG")


@pytest.mark.problem("no-depth")
def test_views_without_depth_fail_the_scan(
    client: httpx2.Client, recording_file: Path, finished: Finished, assert_problem: AssertProblem, tmp_path: Path
) -> None:
    blind = rewrite(
        recording_file,
        tmp_path / "blind.mcap",
        0.0042,
        lambda view: replace(view, depth=np.zeros_like(view.depth)),
    )
    scan = finished(client, start(client, upload(client, blind)))
    assert scan["state"] == "failed"
    assert scan["problem"]["type"] == "urn:pointchain:no-depth"
    assert scan["problem"]["instance"] == scan["links"]["self"]
    assert scan["links"]["model"] is scan["links"]["grasps"] is None
    assert_problem(client.get(scan["links"]["self"] + "/grasps"), 404, "no-result")
    assert client.get(scan["links"]["self"] + "/model").status_code == 404


def test_an_unknown_radius_is_measured(
    client: httpx2.Client,
    recording_file: Path,
    finished: Finished,
    tmp_path: Path,
) -> None:
    unknown = upload(client, rewrite(recording_file, tmp_path / "r.mcap", None, lambda view: view))
    scan = finished(client, start(client, unknown))
    assert scan["string_radius_m"] is None
    (chain,) = client.get(scan["links"]["model"]).json()["chains"]
    assert chain["radius_m"] == pytest.approx(0.0042, rel=0.05)


@pytest.mark.parametrize(
    ("members", "status", "slug", "message"),
    [
        ({"string_radius_m": 0}, 422, "invalid-parameters", "positive"),
        ({"string_radius_m": -0.004}, 422, "invalid-parameters", "positive"),
        ({"string_radius_m": 0.0001}, 422, "invalid-parameters", "0.0005"),
        ({"string_radius_m": 0.1}, 422, "invalid-parameters", "0.02"),
        ({"string_radius_m": "0.004"}, 422, "invalid-request", "string_radius_m"),
        ({"string_radius_m": math.nan}, 422, "invalid-request", "finite"),
        ({"string_radius_m": math.inf}, 422, "invalid-request", "finite"),
        ({"method": "magic"}, 422, "invalid-request", "'matching', 'enhanced' or 'graph'"),
        ({"radius": 0.004}, 422, "invalid-request", "radius"),
        ({"recording": "none"}, 404, "recording-not-found", "upload it"),
        ({"recording": "../x"}, 422, "invalid-request", "recording"),
        ({"mode": "dream"}, 422, "invalid-request", '"replay"'),
        ({"mode": "live", "recording": None}, 422, "invalid-request", "recording"),
    ],
)
def test_an_invalid_request_starts_no_scan(
    *,
    client: httpx2.Client,
    recording: str,
    assert_problem: AssertProblem,
    members: dict[str, Any],
    status: int,
    slug: str,
    message: str,
) -> None:
    before = client.get("/api/scans").json()
    # encoded here, because httpx2 refuses to send NaN
    body = json.dumps({"mode": "replay", "recording": recording} | members)
    answer = client.post("/api/scans", content=body, headers={"Content-Type": "application/json"})
    assert message in assert_problem(answer, status, slug)
    checked = json.dumps({"mode": "replay", "recording": recording, "validate_only": True} | members)
    refused = client.post("/api/scans", content=checked, headers={"Content-Type": "application/json"})
    assert message in assert_problem(refused, status, slug)
    assert client.get("/api/scans").json() == before


def test_a_valid_request_that_is_only_checked_starts_no_scan(client: httpx2.Client, recording: str) -> None:
    before = client.get("/api/scans").json()
    request = {"mode": "replay", "recording": recording, "method": "matching", "validate_only": True}
    answer = client.post("/api/scans", json=request)
    assert answer.status_code == 200, answer.text
    assert answer.json() == {
        "valid": True,
        "mode": "replay",
        "recording": recording,
        "method": "matching",
        "string_radius_m": 0.0042,  # of the recording
        "all_grasps": False,
        "viewpoints": None,
    }
    assert client.get("/api/scans").json() == before


@pytest.mark.parametrize(
    ("body", "status", "slug"),
    [
        (b"", 422, "invalid-request"),
        (b"[", 422, "invalid-request"),
        (b"[]", 422, "invalid-request"),
        (b"\xff", 400, "bad-request"),
        (b'{"mode": "replay", "recording": "' + b"x" * 5000, 413, "too-large"),
    ],
)
def test_an_invalid_body_is_refused(
    client: httpx2.Client, assert_problem: AssertProblem, body: bytes, status: int, slug: str
) -> None:
    answer = client.post("/api/scans", content=body, headers={"Content-Type": "application/json"})
    assert_problem(answer, status, slug)


@pytest.mark.parametrize(
    ("method", "path", "status", "slug"),
    [
        ("GET", "/api/scans/none", 404, "scan-not-found"),
        ("GET", "/api/scans/none/model", 404, "scan-not-found"),
        ("GET", "/api/scans/none/grasps", 404, "scan-not-found"),
        ("POST", "/api/scans/none/cancel", 404, "scan-not-found"),
        ("GET", "/api/scans?limit=0", 422, "invalid-request"),
        ("GET", "/api/none", 404, "not-found"),
        ("DELETE", "/api/scans", 405, "method-not-allowed"),
    ],
)
def test_every_refusal_is_a_problem(
    *, client: httpx2.Client, assert_problem: AssertProblem, method: str, path: str, status: int, slug: str
) -> None:
    assert_problem(client.request(method, path), status, slug)


@pytest.mark.problem("cell-busy")
def test_only_one_scan_runs_at_a_time(
    client: httpx2.Client, recording: str, finished: Finished, assert_problem: AssertProblem, held: int
) -> None:
    address = start(client, recording)
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert_problem(answer, 409, "cell-busy")
    assert answer.headers["location"] == address
    # recognition is frozen, and everything else answers
    assert client.get(address).json()["state"] in ("queued", "processing")
    assert client.get("/healthz").status_code == client.get("/readyz").status_code == 200
    assert_problem(client.get(f"{address}/model"), 409, "result-not-ready")
    assert_problem(client.get(f"{address}/grasps"), 409, "result-not-ready")
    os.kill(held, signal.SIGCONT)
    assert finished(client, address)["state"] == "succeeded"
    # the cell lock is free when the final state can be read
    assert finished(client, start(client, recording))["state"] == "succeeded"


def test_a_scan_can_be_cancelled_and_the_next_one_succeeds(
    client: httpx2.Client, recording: str, finished: Finished, assert_problem: AssertProblem, held: int
) -> None:
    address = start(client, recording)
    cancelled = client.post(client.get(address).json()["links"]["cancel"])
    assert cancelled.status_code == 200
    assert cancelled.json()["state"] == "aborted"
    assert cancelled.json()["problem"]["type"] == "urn:pointchain:aborted"
    assert client.get(address).json() == cancelled.json()
    assert_problem(client.get(f"{address}/preview.png"), 404, "no-result")
    again = client.post(f"{address}/cancel")
    assert again.json() == cancelled.json()

    following = start(client, recording)
    # this scan waits for a new recognition process; its cancel must not wait for it
    assert client.post(f"{following}/cancel").json()["state"] == "aborted"
    done = finished(client, start(client, recording))
    assert done["state"] == "succeeded"
    assert_problem(client.post(done["links"]["self"] + "/cancel"), 409, "not-cancellable")


@pytest.mark.problem("recognition-crashed")
def test_a_crash_of_recognition_fails_only_its_scan(
    client: httpx2.Client, recording: str, finished: Finished, held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    was_sent = threading.Event()
    receive = RecognitionWorker._receive

    def receive_after_task(worker: RecognitionWorker, deadline: float) -> object:
        was_sent.set()
        return receive(worker, deadline)

    monkeypatch.setattr(RecognitionWorker, "_receive", receive_after_task)
    address = start(client, recording)
    assert was_sent.wait(PATIENCE_S)
    os.kill(held, signal.SIGKILL)
    scan = finished(client, address)
    assert scan["state"] == "failed"
    assert scan["problem"]["type"] == "urn:pointchain:recognition-crashed"
    assert "-9" in scan["problem"]["detail"]
    assert finished(client, start(client, recording))["state"] == "succeeded"


def test_a_crash_between_scans_is_repaired_before_the_next_scan(client: ServedClient, recognition_process: int) -> None:
    os.kill(recognition_process, signal.SIGKILL)
    wait_until(lambda: client.get("/readyz").status_code == 200 and client.recognition_pid != recognition_process)
