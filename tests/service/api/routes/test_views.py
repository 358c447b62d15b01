"""Routes of the views of a scan, with their poses and images, also during the scan."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from cell.recording import RecordingWriter, read_recording
from recognition.request import RecognitionRequest
from service.api.images.view_points import MAX_POINTS, MIN_HEIGHT_M, view_points
from service.api.response_cache import MAX_AGE_S
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from service.storage.database import new_id
from service.storage.store import Store
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture
def live(client: ServedClient) -> Iterator[tuple[str, Path]]:
    """Yield the id of a live scan that the store has as running, and the path of its recording."""
    store: Store = client.app.state.context.store
    row = replace(new_scan("live", RecognitionRequest(), NOBODY), id=new_id(), state="scanning")
    store.scans.add(row)
    path = store.folder.recording(row.id)
    yield row.id, path
    path.unlink(missing_ok=True)
    store.scans.end(row.id, "failed", Failure("internal", ""))


def test_the_views_of_a_replay_are_those_of_its_recording(
    client: ServedClient, scan: dict[str, Any], recording_file: Path
) -> None:
    listed = client.get(scan["links"]["views"]).json()["views"]
    views = read_recording(recording_file).views
    assert [view["index"] for view in listed] == [view.index for view in views] == [0, 1, 2, 3]
    for each, view in zip(listed, views, strict=True):
        assert each["T_base_camera"] == view.T_base_camera.tolist()
        assert each["K"] == view.K.tolist()
        assert (each["width"], each["height"]) == (320, 200)
        picture = client.get(each["image"])
        assert picture.headers["content-type"] == "image/png"
        assert picture.content.startswith(b"\x89PNG")
        assert len(picture.content) < 100_000


def test_an_image_is_drawn_once_and_a_client_that_has_it_gets_304(
    client: ServedClient, scan: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    address = f"{scan['links']['views']}/0.png"
    first = client.get(address)
    drawn: list[object] = []
    monkeypatch.setattr("service.api.routes.views.draw_depth", lambda *seen: drawn.append(seen) or b"")
    again = client.get(address, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", first.headers["ETag"])
    assert client.get(address).content == first.content
    assert drawn == []


def test_an_unknown_view_is_not_found(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem
) -> None:
    for index in (4, 999):
        detail = assert_problem(client.get(f"{scan['links']['views']}/{index}.png"), 404, "no-result")
        assert detail == f"scan {scan['id']} has no view {index}, or not yet"
    for index in ("-1", "1000", "x"):
        assert_problem(client.get(f"{scan['links']['views']}/{index}.png"), 422, "invalid-request")
    for path in ("views", "views/0.png", "views/0.ply"):
        assert_problem(client.get(f"/api/scans/none/{path}"), 404, "scan-not-found")


def test_a_scan_without_a_recording_has_no_views(client: ServedClient, assert_problem: AssertProblem) -> None:
    store: Store = client.app.state.context.store
    row = replace(new_scan("replay", RecognitionRequest(), NOBODY), id=new_id(), state="scanning")
    store.scans.add(row)
    store.scans.end(row.id, "failed", Failure("internal", ""))
    for path in ("views", "views/0.png"):
        detail = assert_problem(client.get(f"/api/scans/{row.id}/{path}"), 404, "no-result")
        assert detail == f"scan {row.id} has no recording"


def test_a_live_scan_shows_its_views_when_they_are_recorded(
    client: ServedClient, live: tuple[str, Path], recording_file: Path, assert_problem: AssertProblem
) -> None:
    scan_id, path = live
    own, source = f"/api/scans/{scan_id}/views", read_recording(recording_file)
    assert client.get(f"/api/scans/{scan_id}").json()["links"]["views"] == own
    path.touch()  # created and empty
    assert client.get(own).json() == {"views": []}
    assert_problem(client.get(f"{own}/0.png"), 404, "no-result")
    path.unlink()
    assert client.get(own).json() == {"views": []}
    with RecordingWriter(path, source.header) as writer:
        for number, view in enumerate(source.views, 1):
            writer.write_view(view)
            client.app.state.context.store.scans.set_view(scan_id, view.index, "recorded")  # as in a live scan
            assert len(client.get(own).json()["views"]) == number
            assert client.get(f"{own}/{view.index}.png").status_code == 200
            assert_problem(client.get(f"{own}/{view.index + 1}.png"), 404, "no-result")


def test_the_points_of_a_view_are_those_of_its_depth_image(
    client: ServedClient, scan: dict[str, Any], recording_file: Path
) -> None:
    recording = read_recording(recording_file)
    workspace = np.array(recording.header.workspace_m)
    for listed, view in zip(client.get(scan["links"]["views"]).json()["views"], recording.views, strict=True):
        answer = client.get(listed["cloud"])
        assert answer.headers["content-type"] == "application/octet-stream"
        header, _, data = answer.content.partition(b"end_header\n")
        points = np.frombuffer(data, "<f4").reshape(-1, 3)
        assert f"element vertex {len(points)}\n".encode() in header
        assert 1000 < len(points) <= MAX_POINTS
        assert ((points >= workspace[:, 0]) & (points <= workspace[:, 1])).all()
        # each point lies on the ray of a pixel, at the depth of that pixel
        T_camera_base = np.linalg.inv(view.T_base_camera)
        in_camera = points @ T_camera_base[:3, :3].T + T_camera_base[:3, 3]
        pixels = in_camera @ view.K.T / in_camera[:, 2:]
        columns, rows = pixels[:, :2].round().astype(int).T
        assert np.abs(pixels[:, 0] - columns).max() < 0.01  # float32 rounds by some micrometres
        assert np.abs(view.depth[rows, columns] * view.depth_unit_m - in_camera[:, 2]).max() < 1e-5
        # the string is complete, although the table is sampled
        whole = view_points(replace(view, depth=view.depth.copy()), recording.header)
        above = whole[:, 2] > recording.header.table_z_m + MIN_HEIGHT_M
        assert 100 < above.sum() < 3 * MAX_POINTS // 4
        assert (np.diff(above.astype(int)) <= 0).all()


def test_only_the_last_live_scan_has_a_plan(
    client: ServedClient, live: tuple[str, Path], assert_problem: AssertProblem
) -> None:
    scan_id, _ = live
    address, service = f"/api/scans/{scan_id}/plan", client.app.state.context
    assert_problem(client.get(address), 404, "no-result")
    plan = service.cell.plan(4)
    service.jobs._scans.planned = (scan_id, plan)
    service.response_cache._entries.clear()
    assert client.get(address).json() == plan.to_json()
    assert_problem(client.get("/api/scans/none/plan"), 404, "scan-not-found")


@pytest.mark.parametrize("damage", ["gone", "shorter"])
def test_a_damaged_recording_is_reported(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem, damage: str
) -> None:
    path = client.app.state.context.store.folder.recording(scan["recording"])
    assert client.get(f"{scan['links']['views']}/2.png").status_code == 200
    whole = path.read_bytes()
    try:
        path.unlink() if damage == "gone" else path.write_bytes(whole[:-1])
        time.sleep(MAX_AGE_S)  # until the cached answer expires
        for address in (scan["links"]["views"], f"{scan['links']['views']}/2.png"):
            assert "pointchain doctor" in assert_problem(client.get(address), 500, "damaged")
    finally:
        path.write_bytes(whole)
    assert client.get(f"{scan['links']['views']}/2.png").status_code == 200
