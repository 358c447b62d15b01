"""The camera fails, shows nothing, or sees no string: which views are missing is told, and the others are kept."""

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
from tests.service.faults.moves import assert_one_way, now_in
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
Problem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell with a bare table; each test leaves it able to scan."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), scene="empty") as shared:
        yield shared


class Looks:
    """The looks of the cell's camera, counted from 1 in each scan."""

    def __init__(self, cell: LiveCell, monkeypatch: pytest.MonkeyPatch) -> None:
        self._capture = cell.camera.capture
        self._deeds: dict[int, Callable[[], None]] = {}
        self._count = 0
        monkeypatch.setattr(cell.camera, "capture", self._look)

    def before(self, deeds: dict[int, Callable[[], None]]) -> None:
        """What is done in the next scan before a look, in the thread that has the camera."""
        self._deeds, self._count = deeds, 0

    def _look(self, after_s: float, image: bool = False) -> Frame:
        self._count += 1
        self._deeds.get(self._count, lambda: None)()
        return self._capture(after_s, image)


@pytest.fixture
def looks(cell: LiveCell, monkeypatch: pytest.MonkeyPatch) -> Looks:
    return Looks(cell, monkeypatch)


def views(scan: dict[str, Any], state: str) -> list[dict[str, Any]]:
    return [view for view in scan["progress"]["views"] if view["state"] == state]


def strict(client: httpx2.Client, path: str) -> Any:
    """A document without NaN and infinity, which are no JSON."""

    def refused(constant: str) -> None:
        raise AssertionError(f"{path} holds {constant}")

    return json.loads(client.get(path).content, parse_constant=refused)


def counted(cell: LiveCell) -> dict[tuple[str, str], float]:
    """The metrics of views, by name and label."""
    told = re.findall(r'^pointchain_(views?_\w*total)\{\w+="(\w+)"\} (\S+)', cell.client.get("/metrics").text, re.M)
    return {(name, label): float(value) for name, label, value in told}


@pytest.mark.fault(13)
@rounds(1, 20)
def test_a_killed_camera_costs_one_view_at_most(cell: LiveCell, finished: Finished, looks: Looks, count: int) -> None:
    """It is connected anew in place, once: that one is killed here as well where a view is to be missing."""

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
        looks.before({2: kill, 5: kill_twice} if number % 2 else {5: kill_twice})
        begin = now_in(cell)
        scan = finished(cell.client, cell.start())
        assert scan["state"] == "partial", scan
        assert len(views(scan, "recorded")) == 7
        (missing,) = views(scan, "missing")
        assert "could not be connected again" in missing["reason"]
        assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 7
        wait_until(lambda: cell.state()["state"] == "ready")
        assert_one_way(cell, begin, whole=True)


@pytest.mark.fault(15)
def test_images_that_show_nothing_are_missing_views(cell: LiveCell, finished: Finished, looks: Looks) -> None:
    cell.is_well()
    before = counted(cell)
    looks.before(
        {
            2: lambda: cell.camera.fault("zero"),
            3: lambda: cell.camera.fault("none"),
            5: lambda: cell.camera.fault("constant"),
            6: lambda: cell.camera.fault("none"),
        }
    )
    location = cell.start()
    assert finished(cell.client, location)["state"] == "partial"
    scan = strict(cell.client, location)
    missing = {view["index"]: view["reason"] for view in views(scan, "missing")}
    assert sorted(reason.split(":")[0].split(" (")[0] for reason in missing.values()) == [
        "the depth image has the same depth at all measured pixels",
        "the depth image is all zero",
    ]
    assert len(views(scan, "recorded")) == 6
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 6
    warnings = strict(cell.client, scan["links"]["model"])["quality"]["warnings"]
    for index in missing:
        assert any(f"view {index} is missing" in warning for warning in warnings)
    strict(cell.client, scan["links"]["grasps"])
    more = {name: value - before[name] for name, value in counted(cell).items()}
    assert more["views_total", "recorded"] == 6
    assert more["views_total", "missing"] == more["view_failures_total", "camera"] == 2


@pytest.mark.fault(15)
def test_recorded_images_that_show_nothing_are_left_out_or_refused(
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
    used = {view["index"]: view["reason"] for view in strict(cell.client, scan["links"]["model"])["quality"]["views"]}
    assert [index for index, reason in used.items() if reason is None] == [0, 2]
    assert used[1] == "no pixel has a depth"
    assert used[3] is not None
    assert used[3].startswith("every pixel has the same depth")
    strict(cell.client, scan["links"]["self"])

    # There are NaNs in images of floating point numbers only.
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
def test_too_few_views_fail_the_scan_and_are_kept(cell: LiveCell, finished: Finished, looks: Looks) -> None:
    cell.is_well()
    looks.before({3: lambda: cell.camera.fault("zero")})
    scan = finished(cell.client, cell.start())
    assert (scan["state"], scan["problem"]["type"]) == ("failed", "urn:pointchain:insufficient-views")
    assert len(views(scan, "recorded")) == 2
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 2
    wait_until(lambda: cell.state()["state"] != "busy")
    assert cell.state()["problem"] == "urn:pointchain:insufficient-views"
    cell.camera.fault("none")
    cell.is_well()  # the arm has gone home, and the next scan may be better


@pytest.mark.fault(16)
def test_a_bare_table_is_a_result_with_a_reason(cell: LiveCell, finished: Finished) -> None:
    cell.is_well()
    scan = finished(cell.client, cell.start())
    assert (scan["state"], scan["problem"]) == ("succeeded", None)
    assert scan["summary"]["chains"] == 0
    assert any("no string" in warning for warning in scan["summary"]["warnings"])
    assert strict(cell.client, scan["links"]["model"])["chains"] == []
    assert strict(cell.client, scan["links"]["grasps"])["grasps"] == []
    for link in scan["links"].values():
        if link is not None and link not in (scan["links"]["reprocess"], scan["links"].get("cancel")):
            assert cell.client.get(link, headers={"Range": "bytes=0-9"}).status_code < 500, link
