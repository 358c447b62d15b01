"""Problems of recordings and of scans of them: refused uploads, and scans that fail."""

import os
import signal
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from calibration.target.board import Board
from cell.devices import View
from cell.recording import RecordingHeader, RecordingWriter, read_recording
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.errors import Failure
from service.jobs.submission import new_calibration
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.storage.data_folder import PREVIEW
from service.storage.database import new_id
from tests.service.conftest import ServedClient, wait_until

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


def upload(client: httpx2.Client, content: bytes) -> str:
    answer = client.post("/api/recordings", content=content)
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


def replay(client: httpx2.Client, recording: str, **wanted: Any) -> str:
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording} | wanted)
    assert answer.status_code == 202, answer.text
    return answer.headers["Location"]


def recording_of(path: Path, views: Sequence[View], radius_m: float | None = None) -> bytes:
    """Return a recording of views with consecutive indices."""
    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=radius_m, T_flange_camera=views[0].T_flange_camera)
    with closing(RecordingWriter(path, header)) as writer:
        for index, view in enumerate(views):
            writer.write_view(replace(view, index=index))
    return path.read_bytes()


@pytest.mark.problem("recording-corrupt")
def test_a_changed_byte_is_found_by_the_checksum(
    client: ServedClient, recording_file: Path, assert_problem: AssertProblem
) -> None:
    content = bytearray(recording_file.read_bytes())
    content[len(content) // 2] ^= 1
    assert_problem(client.post("/api/recordings", content=bytes(content)), 422, "recording-corrupt")


@pytest.mark.problem("recording-too-large")
def test_a_record_that_announces_too_much_is_refused(
    client: ServedClient, recording_file: Path, assert_problem: AssertProblem
) -> None:
    content = recording_file.read_bytes()
    # after the magic bytes: the code of the first record and its length
    announced = content[:9] + (1 << 40).to_bytes(8, "little") + content[17:]
    assert_problem(client.post("/api/recordings", content=announced), 413, "recording-too-large")


@pytest.mark.problem("contradicting-views")
def test_views_of_two_scenes_contradict_each_other(client: ServedClient, tmp_path: Path, finished: Finished) -> None:
    views: list[View] = []
    for number in (1, 2):
        path = tmp_path / f"{number}.mcap"
        write_simulation(simulate(make_scene("arc", number), camera_model("exact", (320, 200)), 1, views=2), path)
        views += read_recording(path).views
    content = recording_of(tmp_path / "mixed.mcap", views, 0.0042)
    assert finished(client, replay(client, upload(client, content)))["state"] == "failed"


@pytest.mark.problem("radius-unknown")
def test_the_radius_of_a_box_cannot_be_measured(client: ServedClient, tmp_path: Path, finished: Finished) -> None:
    K = np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 19.5], [0.0, 0.0, 1.0]])
    T_base_flange = np.diag([1.0, -1.0, -1.0, 1.0])
    T_base_flange[2, 3] = 0.3
    views = []
    for index in range(3):
        depth = np.random.default_rng(index).integers(2999, 3002, (40, 64), dtype=np.uint16)
        depth[10:30, 20:40] -= 150  # a box, 15 mm high
        views.append(View(index, depth, 1e-4, K, T_base_flange, np.eye(4)))
    content = recording_of(tmp_path / "box.mcap", views)
    assert finished(client, replay(client, upload(client, content)))["state"] == "failed"


@pytest.mark.problem("recording-unreadable")
def test_a_recording_that_is_removed_before_it_is_read_fails_the_scan(
    client: ServedClient, recording: str, held: int, finished: Finished
) -> None:
    location = replay(client, recording)
    client.app.state.context.store.folder.recording(recording).unlink()
    os.kill(held, signal.SIGCONT)
    assert finished(client, location)["state"] == "failed"


@pytest.mark.problem("invalid-parameters")
def test_a_radius_outside_its_limits_is_refused(
    client: ServedClient, recording: str, assert_problem: AssertProblem
) -> None:
    body = {"mode": "replay", "recording": recording, "string_radius_m": 4.2}
    assert_problem(client.post("/api/scans", json=body), 422, "invalid-parameters")


@pytest.mark.problem("no-result", "result-not-ready")
def test_a_result_that_does_not_exist_is_named(
    *,
    client: ServedClient,
    recording: str,
    scan: dict[str, Any],
    held: int,
    finished: Finished,
    assert_problem: AssertProblem,
) -> None:
    store = client.app.state.context.store
    run = replace(new_calibration("calibration", Board(), 12), id=new_id(), state="scanning")
    store.calibrations.add(run)
    # a run that is really active is refused before, as cell-busy
    assert_problem(client.post(f"/api/calibration/runs/{run.id}/activate"), 409, "result-not-ready")
    store.calibrations.end(run.id, "failed", Failure("internal", "the end of this test"))
    location = replay(client, recording)
    assert_problem(client.get(f"{location}/model"), 409, "result-not-ready")

    client.post(f"{location}/cancel")  # ends the suspended recognition
    finished(client, location)
    assert_problem(client.get(f"{location}/model"), 404, "no-result")
    assert_problem(client.get(f"{scan['links']['self']}/views/99.png"), 404, "no-result")
    assert_problem(client.get(f"/api/calibration/runs/{run.id}/views/7.png"), 404, "no-result")
    preview = store.folder.results(scan["id"]) / PREVIEW
    wait_until(lambda: PREVIEW in (store.scans.get(scan["id"]).files or {}))
    preview.unlink()
    with store.database.transaction() as db:  # no hash of it is recorded
        db.execute("UPDATE scans SET files = json_remove(files, '$.\"preview.png\"') WHERE id = ?", (scan["id"],))
    assert_problem(client.get(scan["links"]["preview"]), 404, "no-result")


INJECTED = (
    "depth-noise", "duplicate-view", "insufficient-views", "invalid-gripper", "invalid-scene", "invalid-view",
    "not-rigid", "recognition-timeout", "recording-content", "table-elsewhere", "too-crowded",
)  # fmt: skip
"""Failures of the recognition process for which no recording or configuration that the service accepts is small."""


@pytest.mark.parametrize("slug", [pytest.param(slug, marks=pytest.mark.problem(slug)) for slug in INJECTED])
def test_a_failure_of_recognition_is_the_problem_of_the_scan(
    client: ServedClient, recording: str, finished: Finished, monkeypatch: pytest.MonkeyPatch, slug: str
) -> None:
    def fail(*_: object) -> None:
        raise TaskFailedError(slug, "the reason")

    monkeypatch.setattr(RecognitionWorker, "run", fail)
    scan = finished(client, replay(client, recording))
    assert (scan["state"], scan["problem"]["detail"]) == ("failed", "the reason")
