"""The camera fails, delivers blank images or sees no string. Missing views are reported, and the others are kept."""

import json
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from mcap_protobuf.writer import Writer

from cell.devices import Frame
from cell.recording import RecordingWriter, read_recording
from cell.recording.header import RecordingHeader
from cell.recording.messages import DEPTH, encode_view
from tests.service.conftest import Serve, wait_until
from tests.service.faults.figures import rounds
from tests.service.faults.moves import assert_followed_plan, log_position
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell with an empty table. Each test leaves it ready to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), scene="empty") as shared:
        yield shared


class Captures:
    """Runs actions before chosen captures of the cell's camera. Captures are counted from 1 in each scan."""

    def __init__(self, cell: LiveCell, monkeypatch: pytest.MonkeyPatch) -> None:
        self._capture = cell.camera.capture
        self._actions: dict[int, Callable[[], None]] = {}
        self._count = 0
        monkeypatch.setattr(cell.camera, "capture", self._capture_after_action)

    def before(self, actions: dict[int, Callable[[], None]]) -> None:
        """Set the actions before captures of the next scan, by number. They run in the camera's thread."""
        self._actions, self._count = actions, 0

    def _capture_after_action(self, after_s: float, image: bool = False) -> Frame:
        self._count += 1
        self._actions.get(self._count, lambda: None)()
        return self._capture(after_s, image)


@pytest.fixture
def captures(cell: LiveCell, monkeypatch: pytest.MonkeyPatch) -> Captures:
    """The captures of the cell's camera."""
    return Captures(cell, monkeypatch)


def views(scan: dict[str, Any], state: str) -> list[dict[str, Any]]:
    """Return the views of a scan in this state."""
    return [view for view in scan["progress"]["views"] if view["state"] == state]


def get_strict_json(client: httpx2.Client, path: str) -> Any:
    """Get a JSON document and assert that it has no NaN and no infinity."""

    def reject_constant(constant: str) -> None:
        raise AssertionError(f"{path} contains {constant}")

    return json.loads(client.get(path).content, parse_constant=reject_constant)


def view_metrics(cell: LiveCell) -> dict[tuple[str, str], float]:
    """Return the metrics of views, by name and label."""
    found = re.findall(r'^pointchain_(views?_\w*total)\{\w+="(\w+)"\} (\S+)', cell.client.get("/metrics").text, re.M)
    return {(name, label): float(value) for name, label, value in found}


@pytest.mark.fault(13)
@rounds(1, 20)
def test_a_killed_camera_loses_at_most_one_view(
    cell: LiveCell, finished: Finished, captures: Captures, count: int
) -> None:
    """The camera is connected again once, at the same viewpoint. A view is missing if that camera is killed too."""

    def kill() -> None:
        assert cell.camera.pid is not None
        os.kill(cell.camera.pid, signal.SIGKILL)

    def kill_twice() -> None:
        first = cell.camera.pid
        kill()

        def kill_next() -> None:
            wait_until(lambda: cell.camera.pid not in (None, first))
            kill()

        threading.Thread(target=kill_next).start()

    for number in range(count):
        cell.is_well()
        captures.before({2: kill, 5: kill_twice} if number % 2 else {5: kill_twice})
        begin = log_position(cell)
        scan = finished(cell.client, cell.start())
        assert scan["state"] == "partial", scan
        assert len(views(scan, "recorded")) == 7
        (missing,) = views(scan, "missing")
        assert "could not be connected again" in missing["reason"]
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 7
        wait_until(lambda: cell.state()["state"] == "ready")
        assert_followed_plan(cell, begin, whole=True)


@pytest.mark.fault(15)
def test_blank_images_are_missing_views(cell: LiveCell, finished: Finished, captures: Captures) -> None:
    cell.is_well()
    before = view_metrics(cell)
    captures.before(
        {
            2: lambda: cell.camera.fault("zero"),
            3: lambda: cell.camera.fault("none"),
            5: lambda: cell.camera.fault("constant"),
            6: lambda: cell.camera.fault("none"),
        }
    )
    location = cell.start()
    assert finished(cell.client, location)["state"] == "partial"
    scan = get_strict_json(cell.client, location)
    missing = {view["index"]: view["reason"] for view in views(scan, "missing")}
    assert sorted(reason.split(":")[0].split(" (")[0] for reason in missing.values()) == [
        "the depth image has the same depth at all measured pixels",
        "the depth image is all zero",
    ]
    assert len(views(scan, "recorded")) == 6
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 6
    findings = get_strict_json(cell.client, scan["links"]["model"])["quality"]["findings"]
    notes = {found["view"]: found["message"] for found in findings if found["code"] == "view-missing"}
    assert notes.keys() == missing.keys()
    assert all(f"view {index} is missing" in message for index, message in notes.items())
    get_strict_json(cell.client, scan["links"]["grasps"])
    increase = {name: value - before[name] for name, value in view_metrics(cell).items()}
    assert increase["views_total", "recorded"] == 6
    assert increase["views_total", "missing"] == increase["view_failures_total", "camera"] == 2


@pytest.mark.fault(15)
def test_recorded_blank_images_are_excluded_or_refused(
    cell: LiveCell, finished: Finished, assert_problem: Problem, recording_file: Path, tmp_path: Path
) -> None:
    recording, kept = read_recording(recording_file), tmp_path / "kept.mcap"
    header = RecordingHeader(recording.views[0].depth_unit_m, 0.0042, recording.views[0].T_flange_camera)
    with RecordingWriter(kept, header) as writer:
        for view, value in zip(recording.views, (None, 0, None, 5000), strict=True):
            depth = view.depth if value is None else np.full_like(view.depth, value)
            writer.write_view(replace(view, depth=depth))
    wait_until(lambda: cell.client.app.state.context.jobs.idle)
    uploaded = cell.client.post("/api/recordings", content=kept.read_bytes()).json()["id"]
    answer = cell.client.post("/api/scans", json={"mode": "replay", "recording": uploaded})
    scan = finished(cell.client, answer.headers["Location"])
    assert scan["state"] == "partial", scan
    used = {
        view["index"]: view["reason"]
        for view in get_strict_json(cell.client, scan["links"]["model"])["quality"]["views"]
    }
    assert [index for index, reason in used.items() if reason is None] == [0, 2]
    assert used[1] == "no pixel has a depth"
    assert used[3] is not None
    assert used[3].startswith("every pixel has the same depth")
    get_strict_json(cell.client, scan["links"]["self"])

    # Only images of floating-point numbers can contain NaN.
    nan = tmp_path / "nan.mcap"
    with nan.open("wb") as stream, Writer(stream) as foreign:
        for topic, message in encode_view(recording.views[0], 1):
            if topic == DEPTH:
                message.encoding, message.step = "32FC1", 4 * message.width
                message.data = np.full((message.height, message.width), np.nan, "<f4").tobytes()
            foreign.write_message(topic, message, 1, 1, 0)
    detail = assert_problem(cell.client.post("/api/recordings", content=nan.read_bytes()), 422, "recording-content")
    assert "32FC1" in detail


@pytest.mark.fault(14)
def test_too_few_views_fail_the_scan_and_are_kept(cell: LiveCell, finished: Finished, captures: Captures) -> None:
    cell.is_well()
    captures.before({3: lambda: cell.camera.fault("zero")})
    scan = finished(cell.client, cell.start())
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:insufficient-views")
    assert len(views(scan, "recorded")) == 2
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 2
    wait_until(lambda: cell.state()["state"] != "busy")
    assert cell.state()["problem"] == "urn:pointchain:insufficient-views"
    cell.camera.fault("none")
    cell.is_well()  # the arm is at home, and another scan is possible


def test_a_scan_with_views_as_needed_expects_all_of_them_once_it_goes_on(cell: LiveCell, finished: Finished) -> None:
    cell.is_well()
    eight = finished(cell.client, cell.start())
    cell.is_well()
    auto = finished(cell.client, cell.start(views="auto"))
    assert len(auto["timing_s"]["views"]) == 8  # an empty table is doubtful
    # The rings come one after the other, which takes longer than the best order of all viewpoints.
    for name in ("expected_to_model", "expected_to_home"):
        assert auto["timing_s"][name] > eight["timing_s"][name]


@pytest.mark.fault(16)
def test_an_empty_table_gives_a_result_with_a_reason(cell: LiveCell, finished: Finished) -> None:
    cell.is_well()
    scan = finished(cell.client, cell.start())
    assert (scan["state"], scan["problem"]) == ("succeeded", None)
    assert scan["summary"]["chains"] == 0
    model = get_strict_json(cell.client, scan["links"]["model"])
    assert {found["code"] for found in model["quality"]["findings"]} & {"no-string-in-view", "no-string-found"}
    assert model["chains"] == []
    assert get_strict_json(cell.client, scan["links"]["grasps"])["grasps"] == []
    for link in scan["links"].values():
        if link is not None and link not in (scan["links"]["reprocess"], scan["links"].get("cancel")):
            assert cell.client.get(link, headers={"Range": "bytes=0-9"}).status_code < 500, link
